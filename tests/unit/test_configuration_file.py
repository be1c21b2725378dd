# SPDX-License-Identifier: Apache-2.0
"""The configuration file says what was meant, or is refused by name."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from flock_sim import configuration_file
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.errors import FlockError


def read(tmp_path: Path, text: str) -> FlockConfiguration:
    file = tmp_path / "flock.yaml"
    file.write_text(text, encoding="utf-8")
    return FlockConfiguration.from_parameters(configuration_file.read(file))


@pytest.mark.parametrize(
    "text",
    ["", "# nothing yet\n", "/**:\n  ros__parameters:\n", "/**:\n  ros__parameters: {}\n"],
)
def test_an_empty_file_is_the_defaults(tmp_path: Path, text: str) -> None:
    assert read(tmp_path, text) == FlockConfiguration()


def test_the_file_of_the_contract_is_the_defaults_and_one_bird(tmp_path: Path) -> None:
    text = """
/**:
  ros__parameters:
    birds: 13                    # >= 1
    coupling: nearest            # or: all
    dt: 1.0                      # in b/U_min
    t_max: 10000.0
    record_every: 10             # steps
    body_mass: 3.8               # kg
    wing_span: 1.5               # m, full
    air_density: 1.225           # kg/m^3
    min_drag_speed: 18.0         # m/s
    cruise_speed: 18.5           # m/s
    oswald_efficiency: 0.8
    zero_lift_drag: 0.025        # C_D
    aspect_ratio: 9.0
    span_ratios: ["4=1.05"]      # as --span-ratio
"""
    assert read(tmp_path, text) == FlockConfiguration(span_ratios=("4=1.05",))


@pytest.mark.parametrize("number", ["1e4", "1E4", "1.0e+4", "10000", "10000.0", '"1e4"', "+1e4"])
def test_a_number_may_be_written_in_any_usual_way(tmp_path: Path, number: str) -> None:
    text = f"/**:\n  ros__parameters:\n    t_max: {number}\n"
    assert read(tmp_path, text).t_max == 1e4


lengths = st.floats(1e-3, 1e3)


@given(
    birds=st.integers(4, 30),
    dt=st.floats(1e-3, 10.0),
    steps=st.integers(1, 10**6),
    record_every=st.integers(1, 1000),
    body_mass=lengths,
    ratios=st.lists(st.floats(0.51, 2.0), min_size=1, max_size=4),
    coupling=st.sampled_from(["nearest", "all"]),
)
def test_what_is_written_is_read_back_to_the_bit(
    birds: int,
    dt: float,
    steps: int,
    record_every: int,
    body_mass: float,
    ratios: list[float],
    coupling: str,
) -> None:
    flown = FlockConfiguration(
        birds=birds,
        coupling=coupling,
        dt=dt,
        t_max=steps * dt,
        record_every=record_every,
        body_mass=body_mass,
        span_ratios=("4=" + ",".join(map(repr, ratios)),),
    )
    content = yaml.safe_load(configuration_file.text(flown.parameters()))
    assert list(content) == ["/**"]
    assert FlockConfiguration.from_parameters(content["/**"]["ros__parameters"]) == flown


def test_no_empty_list_is_written_since_ros_has_no_type_for_it() -> None:
    assert "span_ratios" not in configuration_file.text(FlockConfiguration().parameters())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/**: [1\n", r"not YAML at line 2, column 1"),
        ("a: b: c\n", r"not YAML at line 1, column 5"),
        ("- 1\n", r"must have a section `/\*\*:`"),
        ("flock:\n  ros__parameters:\n    birds: 3\n", r"unknown section 'flock'"),
        ("/**:\n  ros_parameters: {}\n", r"did you mean 'ros__parameters'"),
        ("/**:\n", r"must have a section `ros__parameters:`"),
        ("/**:\n  ros__parameters: 5\n", r"must hold `key: value` lines"),
        ("&a [*a\n", r"not YAML"),
    ],
)
def test_what_is_no_parameter_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(FlockError, match=said) as refused:
        read(tmp_path, text)
    assert str(tmp_path / "flock.yaml") in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlockError, match="No such file or directory"):
        configuration_file.read(tmp_path / "missing.yaml")
    with pytest.raises(FlockError, match="Is a directory"):
        configuration_file.read(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with pytest.raises(FlockError, match="UTF-8"):
        configuration_file.read(tmp_path / "binary")

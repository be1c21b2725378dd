# SPDX-License-Identifier: Apache-2.0
"""The configuration file is read as meant, or refused with the name of the fault."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError


def read(tmp_path: Path, text: str) -> FlockConfiguration:
    file = tmp_path / "flock.yaml"
    file.write_text(text, encoding="utf-8")
    return FlockConfiguration.from_parameters(parameter_file.read(file))


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
    birds=st.integers(1, 30),
    dt=st.floats(1e-3, 10.0),
    steps=st.integers(1, 10**6),
    record_every=st.integers(1, 1000),
    body_mass=lengths,
    ratios=st.lists(st.floats(0.51, 3.0), min_size=1, max_size=4),
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
        span_ratios=(f"{birds}=" + ",".join(map(repr, ratios)),),
        perturbations=(f"{birds}:{len(ratios)}@{steps}={ratios[0]!r}", "1@0=0,-0.1"),
    )
    content = yaml.safe_load(parameter_file.text(flown.parameters()))
    assert list(content) == ["/**"]
    for parameters in (flown.parameters(), content["/**"]["ros__parameters"]):
        again = FlockConfiguration.from_parameters(parameters)
        assert again == flown
        assert again.span_ratio.tobytes() == flown.span_ratio.tobytes()


def test_no_empty_list_is_written_since_ros_has_no_type_for_it() -> None:
    assert "span_ratios" not in parameter_file.text(FlockConfiguration().parameters())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/**: [1\n", r"not YAML at line 2, column 1"),
        ("a: b: c\n", r"not YAML at line 1, column 5"),
        ("- 1\n", r"must have a section `/\*\*:`"),
        ("birds: 3\n", r"unknown section 'birds'"),
        ("flock:\n  birds: 3\n", r"unknown section 'birds' in /flock: known are ros__parameters"),
        ("/flock/bird*:\n  ros__parameters: {}\n", r"'/flock/bird\*' names no node"),
        ("/flock/bird 3:\n  ros__parameters: {}\n", r"'/flock/bird 3' names no node"),
        ("/flock: {}\n", r"must have a section `ros__parameters:` in /flock"),
        ("/**: {ros__parameter: {birds: 3}}\n", r"did you mean 'ros__parameters'"),
        ("ros__parameters:\n  birds: 3\n", r"unknown section 'birds'"),
        ("/**: &a {x: *a}\n", r"line 1: alias \*a: is in the value that it stands for"),
        ("/**:\n  ros__parameters: {" + "x: {" * 20 + "y: 1" + "}" * 21, r"nested too deep"),
        ("/**:\n  ros_parameters: {}\n", r"did you mean 'ros__parameters'"),
        ("/**:\n", r"must have a section `ros__parameters:`"),
        ("/**:\n  ros__parameters: 5\n", r"must hold `key: value` lines"),
        ("[a\n", r"not YAML"),
        ("/**: {ros__parameters: {birds: " + "9" * 5000 + "}}\n", r"too many digits"),
        ("[" * 5000, r"nested too deep"),
    ],
)
def test_what_is_no_parameter_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(FlockError, match=said) as refused:
        read(tmp_path, text)
    assert str(tmp_path / "flock.yaml") in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FlockError, match="No such file or directory"):
        parameter_file.read(tmp_path / "missing.yaml")
    with pytest.raises(FlockError, match="Is a directory"):
        parameter_file.read(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    with pytest.raises(FlockError, match="UTF-8"):
        parameter_file.read(tmp_path / "binary")


SECTIONS = """
/**:
  ros__parameters: {birds: 3, t_max: 50}
/flock/clock:
  ros__parameters: {window: 1}
flock:
  bird_03:
    ros__parameters: {timeout: 7.0, qos_overrides: {/clock: {publisher: {depth: 5}}}}
/camera/driver:
  ros__parameters: {exposure: 3}
"""


def sections(tmp_path: Path, *texts: str) -> parameter_file.Sections:
    files = [tmp_path / f"{number}.yaml" for number in range(len(texts))]
    for file, text in zip(files, texts, strict=True):
        file.write_text(text, encoding="utf-8")
    return parameter_file.sections(*files)


def test_a_tool_without_nodes_reads_what_is_for_all_and_names_what_it_skips(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert read(tmp_path, SECTIONS) == FlockConfiguration(birds=3, t_max=50.0)
    assert capsys.readouterr().err == (
        f"note: {tmp_path / 'flock.yaml'}: only the section /** is read; skipped: "
        "/flock/clock, /flock/bird_03, /camera/driver\n"
    )


def test_a_node_has_what_is_for_all_and_what_is_for_it(tmp_path: Path) -> None:
    found = sections(tmp_path, SECTIONS)
    both = {"birds": 3, "t_max": 50}
    assert found.of("/flock/bird_01") == both
    assert found.of("/flock/clock") == {**both, "window": 1}
    own = {"timeout": 7.0, "qos_overrides./clock.publisher.depth": 5}
    assert found.of("/flock/bird_03") == {**both, **own}
    assert found.own("/flock/bird_03") == own
    assert found.unmatched(["/flock/clock", "/flock/bird_03"]) == ["/camera/driver"]


@pytest.mark.parametrize("first", ["/**", "/flock/bird_03"])
def test_the_section_of_a_node_wins_over_that_of_all_wherever_it_stands(
    tmp_path: Path, first: str
) -> None:
    values = {"/**": 1.0, "/flock/bird_03": 2.0}
    names = sorted(values, key=lambda name: name != first)
    text = "".join(f"{name}: {{ros__parameters: {{timeout: {values[name]}}}}}\n" for name in names)
    assert sections(tmp_path, text).of("/flock/bird_03") == {"timeout": 2.0}


def test_a_later_file_wins(tmp_path: Path) -> None:
    texts = [f"/flock/clock: {{ros__parameters: {{window: {k}, timeout: 1e{k}}}}}" for k in (1, 2)]
    texts.append("/flock/clock: {ros__parameters: {window: 3}}")
    assert sections(tmp_path, *texts).of("/flock/clock") == {"window": 3, "timeout": 100.0}


@pytest.mark.parametrize(
    ("pattern", "matches"),
    [
        ("/**", "/flock/bird_03 /bird_03 /a/flock/bird_03 /flock/clock"),
        ("/*", "/bird_03"),
        ("/flock/*", "/flock/bird_03 /flock/clock"),
        ("/*/bird_03", "/flock/bird_03"),
        ("/**/bird_03", "/flock/bird_03 /bird_03 /a/flock/bird_03"),
        ("/flock/**", "/flock/bird_03 /flock/clock"),
        ("/**/flock/*", "/flock/bird_03 /a/flock/bird_03 /flock/clock"),
        ("/*/*/*", "/a/flock/bird_03"),
        ("/bird_03", "/bird_03"),
        ("bird_03", "/bird_03"),
    ],
)
def test_wildcards_stand_for_parts_of_names(tmp_path: Path, pattern: str, matches: str) -> None:
    found = sections(tmp_path, f'"{pattern}": {{ros__parameters: {{birds: 3}}}}')
    nodes = ["/flock/bird_03", "/bird_03", "/a/flock/bird_03", "/flock/clock"]
    assert [node for node in nodes if found.of(node)] == matches.split()

# SPDX-License-Identifier: Apache-2.0
"""`compare` finds every bit that differs between flights, and nothing else."""

import shutil
import struct
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.state import ARRAYS, VALUES
from flock_sim.messages.types import State
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording.run import Run
from flock_tools.runs import pairing
from flock_tools.runs.comparison import Comparison, compare
from support.flights import Change, keep, record

CONFIGURATION = FlockConfiguration(
    birds=5, t_max=40.0, record_every=2, span_ratios=("2=1.0,1.02,0.97", "4=1.01")
)
STEPS = range(0, 41, 2)
MESSAGES = CONFIGURATION.birds * len(STEPS)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory name that every example of hypothesis may use anew."""
    return tmp_path_factory.mktemp("scratch") / "run"


def compared(first: Path, second: Path, tolerance: float | None = None) -> Comparison:
    with Run(first) as one, Run(second) as other:
        return compare(one, other, tolerance)


def snapshots(path: Path) -> list[FlockState]:
    with Run(path) as run:
        return list(run.snapshots())


def at(bird: int, when: int, /, **changes: object) -> Change:
    """Changes one state; a function among `changes` makes the new value of the old one."""

    def change(who: int, state: State) -> State:
        if (who, state.step) != (bird, when):
            return state
        new = {
            name: value(getattr(state, name)) if callable(value) else value
            for name, value in changes.items()
        }
        return replace(state, **new)

    return change


def with_bit_flipped(values: np.ndarray, member: int, bit: int) -> np.ndarray:
    bits = np.array(values).view(np.uint64)
    bits[member] ^= np.uint64(1 << bit)
    return bits.view(np.float64)


def with_value(member: int, value: float):
    def change(values: np.ndarray) -> np.ndarray:
        changed = np.array(values)
        changed[member] = value
        return changed

    return change


def test_who_flew_and_how_does_not_matter(flight: Path, tmp_path: Path) -> None:
    other = record(tmp_path / "run", CONFIGURATION, run_id=7, grants=True)
    result = compared(flight, other)
    assert result.equal
    assert result.messages == MESSAGES
    assert result.max_difference == dict.fromkeys(VALUES, 0.0)


@given(
    bird=st.integers(1, 5),
    step=st.sampled_from(STEPS),
    name=st.sampled_from(ARRAYS),
    member=st.integers(0, 2),
    bit=st.integers(0, 63),
)
def test_no_bit_of_any_value_escapes(
    flight: Path, scratch: Path, bird: int, step: int, name: str, member: int, bit: int
) -> None:
    shutil.rmtree(scratch, ignore_errors=True)
    flip = at(bird, step, **{name: lambda values: with_bit_flipped(values, member, bit)})
    record(scratch, CONFIGURATION, flip)
    result = compared(flight, scratch)
    found = result.first_difference
    assert found is not None
    assert (found.bird, found.step, found.field, found.member) == (bird, step, name, member + 1)
    assert found.time == step * CONFIGURATION.dt
    assert found.bits is not None
    assert int(found.bits[0], 16) ^ int(found.bits[1], 16) == 1 << bit
    assert result.different == 1


@pytest.mark.parametrize(
    ("field", "changes"),
    [
        ("header.stamp", {"nanoseconds": 1}),
        ("header.stamp", {"seconds": -1}),
        ("header.frame_id", {"frame": "flocc"}),
        ("header.frame_id", {"frame": "a frame with a longer name"}),
        ("time", {"time": np.nextafter(8.0, 9.0)}),
        ("speed", {"speed": np.ones(2)}),
        ("circulation", {"circulation": np.ones(0)}),
    ],
)
@pytest.mark.parametrize("tolerance", [None, 1.0])
def test_every_other_field_counts_exactly_whatever_the_tolerance(
    flight: Path, tmp_path: Path, field: str, changes: dict, tolerance: float | None
) -> None:
    record(tmp_path / "run", CONFIGURATION, at(3, 8, **changes))
    found = compared(flight, tmp_path / "run", tolerance).first_difference
    assert found is not None
    assert (found.kind, found.field, found.bird, found.step) == ("state", field, 3, 8)


def test_a_step_that_one_bag_counts_otherwise_is_missing_in_the_other(
    flight: Path, tmp_path: Path
) -> None:
    record(tmp_path / "run", CONFIGURATION, at(2, 8, step=9))
    result = compared(flight, tmp_path / "run")
    assert result.missing == [1, 1]
    assert result.state is not None
    assert (result.state.kind, result.state.step) == ("missing", 8)
    assert result.state.values == (True, False)


def test_signed_zeros_and_kinds_of_nan_differ_only_without_tolerance(tmp_path: Path) -> None:
    other_nan = struct.unpack("<d", struct.pack("<Q", 0x7FF8_0000_0000_0001))[0]
    values = [(0.0, -0.0), (nan, other_nan), (nan, -nan)]
    for number, pair in enumerate(values):
        runs = [
            record(tmp_path / f"{number}{k}", CONFIGURATION, at(1, 4, speed=with_value(1, pair[k])))
            for k in (0, 1)
        ]
        exact = compared(*runs)
        assert not exact.equal
        assert exact.max_difference["speed"] == 0.0
        assert compared(*runs, tolerance=0.0).equal


def test_a_tolerance_is_the_largest_difference_allowed(flight: Path, tmp_path: Path) -> None:
    gap = 2.0**-20  # with positions of this size, added without rounding

    def further(values: np.ndarray) -> np.ndarray:
        return np.round(values * 2**30) / 2**30 + np.array([0.0, gap, 0.0])

    def rounded(values: np.ndarray) -> np.ndarray:
        return np.round(values * 2**30) / 2**30

    one = record(tmp_path / "one", CONFIGURATION, at(4, 10, position=rounded))
    two = record(tmp_path / "two", CONFIGURATION, at(4, 10, position=further))
    assert compared(one, two, gap).equal
    apart = compared(one, two, np.nextafter(gap, 0.0))
    assert not apart.equal
    assert apart.max_difference == {**dict.fromkeys(VALUES, 0.0), "position": gap}
    assert apart.first_difference is not None
    assert apart.first_difference.distance == gap


def test_the_largest_difference_of_each_field_is_found(flight: Path, tmp_path: Path) -> None:
    other = replace(CONFIGURATION, cruise_speed=18.6)
    record(tmp_path / "run", other)
    result = compared(flight, tmp_path / "run")
    runs = [snapshots(path) for path in (flight, tmp_path / "run")]
    for name in VALUES:
        gaps = [np.abs(getattr(a, name) - getattr(b, name)).max() for a, b in zip(*runs)]
        assert result.max_difference[name] == max(gaps)
    assert result.different == MESSAGES
    assert result.state is not None
    assert (result.state.step, result.state.bird, result.state.field) == (0, 1, "speed")


def test_states_that_are_not_laid_out_as_ours_are_judged_the_same(tmp_path: Path) -> None:
    """Another frame takes the path that decodes message by message."""

    def framed(change: Change) -> Change:
        return lambda bird, state: replace(change(bird, state), frame="elsewhere")

    shift = at(3, 6, circulation=lambda values: values + 1e-9)
    results = []
    for wrap in (lambda change: change, framed):
        place = tmp_path / ("plain" if wrap is not framed else "framed")
        runs = [record(place / str(k), CONFIGURATION, wrap((keep, shift)[k])) for k in (0, 1)]
        results.append([compared(*runs, tolerance) for tolerance in (None, 1e-12, 1e-8)])
    for plain, decoded in zip(*results):
        assert plain == decoded
    assert [result.equal for result in results[0]] == [False, False, True]


@pytest.mark.parametrize("limit", [pairing.MOST_WAITING, 3000, 0])
def test_the_order_in_which_birds_were_recorded_does_not_matter(
    flight: Path, tmp_path: Path, limit: int
) -> None:
    sorted_by_bird = record(tmp_path / "run", CONFIGURATION, bird_by_bird=True)
    with BagReader(flight) as one, BagReader(sorted_by_bird) as two:
        topics = [f"/flock/bird_{bird:02d}/state" for bird in range(1, 6)]
        found = list(pairing.pairs(one, two, topics, limit))
    assert len(found) == MESSAGES
    assert all(left == right and left is not None for _, left, right in found)
    assert compared(flight, sorted_by_bird).equal


def test_a_single_lost_message_does_not_make_the_others_differ(
    flight: Path, tmp_path: Path
) -> None:
    record(
        tmp_path / "run",
        CONFIGURATION,
        lambda bird, state: None if (bird, state.step) == (2, 12) else state,
    )
    result = compared(flight, tmp_path / "run")
    assert (result.messages, result.different, result.missing) == (MESSAGES - 1, 0, [0, 1])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("birds", 4),
        ("coupling", "all"),
        ("dt", 0.5),
        ("t_max", 42.0),
        ("record_every", 4),
        ("body_mass", 3.9),
        ("wing_span", 1.6),
        ("air_density", 1.2),
        ("min_drag_speed", 17.0),
        ("cruise_speed", 19.0),
        ("oswald_efficiency", 0.9),
        ("zero_lift_drag", 0.03),
        ("aspect_ratio", 9.5),
        ("span_ratios", ("2=1.0,1.02,0.97", "4=1.02")),
        ("links", ("hold:delay=1",)),
    ],
)
def test_every_key_of_the_configuration_counts(
    flight: Path, tmp_path: Path, key: str, value: object
) -> None:
    other = replace(CONFIGURATION, **{key: value})
    record(tmp_path / "run", other, states=[])
    found = compared(flight, tmp_path / "run").first_difference
    assert found is not None
    assert (found.kind, found.field) == ("configuration", key)
    written = list if key in ("span_ratios", "links") else lambda value: value
    assert found.values == (written(getattr(CONFIGURATION, key)), written(value))


def test_the_same_spans_in_other_words_are_the_same_flock(flight: Path, tmp_path: Path) -> None:
    same = replace(CONFIGURATION, span_ratios=("4=1.010", "2=1,1.02,97e-2", "1=1"))
    assert compared(flight, record(tmp_path / "run", same)).equal


def test_the_same_links_in_other_words_are_the_same_flock(flight: Path, tmp_path: Path) -> None:
    exact = replace(CONFIGURATION, links=("hold", "exact"))
    assert compared(flight, record(tmp_path / "exact", exact)).equal
    one = replace(CONFIGURATION, links=("hold:noise=0.1", "1->2=linear"))
    other = replace(
        CONFIGURATION, links=("hold:speed_noise=0.10,position_noise=1e-1", "1->2=linear:delay=0")
    )
    record(tmp_path / "one", one)
    assert compared(tmp_path / "one", record(tmp_path / "other", other)).equal


def test_a_wing_of_another_shape_is_found(flight: Path, tmp_path: Path) -> None:
    ratio = CONFIGURATION.span_ratio.copy()
    ratio[2, 1] = np.nextafter(ratio[2, 1], 2.0)
    record(tmp_path / "run", CONFIGURATION, span_ratio=ratio)
    for tolerance in (None, 1.0):
        found = compared(flight, tmp_path / "run", tolerance).first_difference
        assert found is not None
        assert (found.kind, found.bird, found.member) == ("wing", 3, 2)

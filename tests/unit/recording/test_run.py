# SPDX-License-Identifier: Apache-2.0
"""A run is read back as it was flown, also from an incomplete bag."""

import gc
import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.bag.topic import Topic
from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import Perturbation
from flock_sim.errors import FlockError
from flock_sim.launcher.reference_flight import row
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.state import ARRAYS
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference
from support.flights import record

CONFIGURATION = FlockConfiguration(birds=3, t_max=60.0, record_every=3, span_ratios=("3=0.99,1.0",))


Open = Callable[[Path], Run]


@pytest.fixture
def opened() -> Iterator[Open]:
    """Opens runs for the length of a test."""
    with ExitStack() as stack:
        yield lambda path: stack.enter_context(Run(path))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION)


def test_every_recorded_step_comes_back_to_the_bit(flight: Path, opened: Open) -> None:
    run = opened(flight)
    assert run.configuration == CONFIGURATION
    assert run.missing is None
    snapshots = list(run.snapshots())
    flown = list(Reference(CONFIGURATION).fly())
    assert [snapshot.step for snapshot in snapshots] == list(range(0, 61, 3))
    for snapshot, recorded in zip(snapshots, flown, strict=True):
        assert snapshot.time == recorded.step * CONFIGURATION.dt
        for name in ARRAYS:
            assert getattr(snapshot, name).tobytes() == getattr(recorded, name).tobytes()


def test_wings_are_those_of_the_configuration(flight: Path, opened: Open) -> None:
    wings = opened(flight).wings()
    assert sorted(wings) == [1, 2, 3]
    for bird, ratio in wings.items():
        np.testing.assert_array_equal(ratio, CONFIGURATION.span_ratio[bird - 1])


def test_the_last_step_is_the_last_that_every_bird_has(tmp_path: Path, opened: Open) -> None:
    record(
        tmp_path / "run",
        CONFIGURATION,
        lambda bird, state: None if bird > 1 and state.step > 3 * 5 * bird - 18 else state,
    )
    run = opened(tmp_path / "run")
    assert run.at().step == 12
    assert run.at(3.0).step == 3


def test_a_last_step_long_before_the_end_of_the_bag_is_found(tmp_path: Path, opened: Open) -> None:
    configuration = replace(CONFIGURATION, t_max=1500.0)
    record(
        tmp_path / "run",
        configuration,
        lambda bird, state: None if bird == 2 and state.step > 0 else state,
    )
    assert opened(tmp_path / "run").at().step == 0


def test_a_bag_that_was_torn_off_gives_what_is_whole(
    flight: Path, tmp_path: Path, opened: Open
) -> None:
    configuration = replace(CONFIGURATION, t_max=15000.0)
    path = record(tmp_path / "run", configuration)
    (path / "metadata.yaml").unlink()
    (file,) = path.glob("*.mcap")
    os.truncate(file, file.stat().st_size * 2 // 3)
    run = opened(path)
    assert run.missing is not None
    last = run.at()
    assert 0 < last.step < 15000
    assert run.at(last.time).step == last.step
    with pytest.raises(FlockError, match="not recorded"):
        run.at(15000.0)


@pytest.mark.parametrize("time", [1.0, 63.0, 1e300, -3.0, float("nan"), float("inf")])
def test_a_time_that_was_not_recorded_is_refused(flight: Path, time: float, opened: Open) -> None:
    with pytest.raises(FlockError, match="time"):
        opened(flight).at(time)


def test_the_time_that_was_asked_for_is_named_with_all_its_digits(
    flight: Path, opened: Open
) -> None:
    for time in ("64.0000001", "1e+300", "-3", "123456789"):
        with pytest.raises(FlockError, match=f"time {re.escape(time)}: not recorded"):
            opened(flight).at(float(time))


def test_decimal_times_are_found_in_spite_of_their_rounding(tmp_path: Path, opened: Open) -> None:
    configuration = FlockConfiguration(birds=1, dt=0.1, t_max=3.0, record_every=1)
    run = opened(record(tmp_path / "run", configuration))
    for step in range(31):
        assert run.at(float(f"{step / 10}")).step == step


def test_a_flight_without_states_is_refused(tmp_path: Path, opened: Open) -> None:
    run = opened(record(tmp_path / "run", CONFIGURATION, states=[]))
    with pytest.raises(FlockError, match="no recorded step is complete"):
        run.at()


def test_states_of_another_number_of_members_are_refused(tmp_path: Path, opened: Open) -> None:
    record(
        tmp_path / "run",
        CONFIGURATION,
        lambda bird, state: replace(state, speed=np.ones(3)) if bird == 2 else state,
    )
    with pytest.raises(FlockError, match="2 members"):
        opened(tmp_path / "run").at()


def test_bytes_that_are_no_state_are_refused(flight: Path, opened: Open) -> None:
    run = opened(flight)
    with pytest.raises(FlockError, match="BirdState"):
        run.decode("/flock/bird_01/state", messages.ENCAPSULATION + b"\1\2\3")


def test_a_bag_of_something_else_is_refused(tmp_path: Path, opened: Open) -> None:
    with BagWriter(tmp_path / "bag", [Topic("/chatter", "std_msgs/msg/Header")], {}) as bag:
        bag.write("/chatter", 0, b"\0\1\0\0")
    with pytest.raises(FlockError, match="not a bag of Flock's"):
        opened(tmp_path / "bag")


PUSHES = [
    Perturbation(step=60, bird=2, member=1, position=0.5, speed=0.0),
    Perturbation(step=3, bird=1, member=2, position=0.1, speed=-0.01),
    Perturbation(step=3, bird=1, member=2, position=0.2, speed=0.01),
]


def pushed(path: Path, messages_of_it: list[messages.Push], rows_to: int = 60) -> Path:
    """Record a flight up to step `rows_to` in which these were asked for before it began."""
    states = [state for state in Reference(CONFIGURATION).fly() if state.step <= rows_to]
    with recording(path, CONFIGURATION, grants=True) as run:
        for message in messages_of_it:
            run.write_perturbation(message)
        for state in states:
            run.write_row(row(CONFIGURATION, state))
    return path


def test_what_was_asked_for_in_flight_comes_back_in_order_of_number(
    tmp_path: Path, opened: Open
) -> None:
    sent = [messages.Push.of(7, number, push) for number, push in enumerate(PUSHES, start=1)]
    # As a recorder that was started again may have it: the first a second time.
    run = opened(pushed(tmp_path / "run", [sent[1], sent[0], sent[2], sent[0]]))
    assert run.perturbations() == PUSHES
    stamps = [time for _, time, _ in run.bag.messages([topics.PERTURBATION_TOPIC])]
    assert stamps == [CONFIGURATION.stamp(step) for step in (3, 60, 3, 60)]


def test_a_run_that_nobody_pushed_has_no_perturbations(flight: Path, opened: Open) -> None:
    assert opened(flight).perturbations() == []


@pytest.mark.parametrize(
    "change", [{"bird": 4}, {"bird": 0}, {"member": 3}, {"step": 61}, {"speed": float("nan")}]
)
def test_a_recorded_push_of_what_is_not_there_is_refused(
    tmp_path: Path, opened: Open, change: dict[str, float]
) -> None:
    message = replace(messages.Push.of(7, 1, PUSHES[1]), **change)
    run = opened(pushed(tmp_path / "run", [message]))
    with pytest.raises(FlockError, match=r"remove it with \./flock repair"):
        run.perturbations()


def test_two_pushes_of_one_number_are_refused(tmp_path: Path, opened: Open) -> None:
    run = opened(pushed(tmp_path / "run", [messages.Push.of(7, 1, push) for push in PUSHES[:2]]))
    with pytest.raises(FlockError, match="perturbation 1 is both '2:1@60"):
        run.perturbations()


@pytest.mark.parametrize(("rows_to", "time"), [(60, None), (57, "57"), (0, "0")])
def test_a_push_to_come_is_not_taken_for_what_was_flown(
    tmp_path: Path, opened: Open, rows_to: int, time: str | None
) -> None:
    sent = [messages.Push.of(7, 1, PUSHES[0])]  # at the very end
    run = opened(pushed(tmp_path / "run", sent, rows_to))
    assert run.at().step == rows_to
    if time is None:
        assert run.missing is None
    else:
        assert f"ended at t = {time} of 60" in str(run.missing)


@pytest.mark.filterwarnings("error")
def test_no_file_is_left_open(flight: Path, tmp_path: Path) -> None:
    with Run(flight) as run:
        run.metrics()
    with BagWriter(tmp_path / "foreign", [Topic("/chatter", "std_msgs/msg/Header")], {}):
        pass
    with pytest.raises(FlockError):
        Run(tmp_path / "foreign")
    gc.collect()


def test_the_verdict_on_a_bag_is_that_on_the_same_states_in_memory(tmp_path: Path) -> None:
    configuration = FlockConfiguration(
        birds=3, t_max=9000.0, span_ratios=("1=1,0.7,1",), perturbations=("1:3@500=0,-0.72",)
    )
    flown = Flown(configuration, list(Reference(configuration).fly()))
    with Run(record(tmp_path / "run", configuration)) as run:
        assert run.verdicts() == flown.verdicts()
        assert run.verdicts(400.0).verdict == ["settling"] * 3
    assert flown.verdicts().verdict == ["holds", "apart", "stalled"]


def test_few_of_many_rows_are_found_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configuration = FlockConfiguration(birds=3, t_max=600.0, record_every=1)
    with Run(record(tmp_path / "run", configuration)) as run:
        together = [state.position for state in run.snapshots_at([0, 7, 300, 600])]
        monkeypatch.setattr("flock_sim.recording.run.SPARSE", 1)
        apart = [state.position for state in run.snapshots_at([0, 7, 300, 600])]
    assert len(apart) == 4
    np.testing.assert_array_equal(apart, together)


@pytest.mark.parametrize("change", [{"step": 2**64 - 1}, {"time": 1e300}, {"time": np.nan}])
def test_a_state_at_an_impossible_time_is_refused(
    tmp_path: Path, opened: Open, change: dict[str, float]
) -> None:
    def last_step(bird: int, state: messages.State) -> messages.State:
        return replace(state, **change) if state.step == 60 else state

    run = opened(record(tmp_path / "run", CONFIGURATION, last_step))
    with pytest.raises(FlockError, match=r"a state has step .* which can't be recorded"):
        run.at()

# SPDX-License-Identifier: Apache-2.0
"""Every way to fly gives the same flight: equal bit for bit, and each message once.

The flights cover every pair of: processes 1, 2, 13; window 1, 8, 64; executor; coupling; spans as
standard, of one bird, of three members. N = 1, 2, 8 and 13 are among them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.recording.run import Run
from support.terminal import Terminal, open_terminal

Reference = Callable[[tuple[str, ...]], Path]


@dataclass(frozen=True)
class Case:
    """A flight: of what flock, and how."""

    birds: int
    coupling: str
    spans: tuple[str, ...]
    steps: int
    record_every: int
    processes: int
    window: int
    executor: str

    @property
    def flock(self) -> tuple[str, ...]:
        spans = [word for span in self.spans for word in ("--span-ratio", span)]
        flight = ("--t-max", f"{self.steps}", "--record-every", f"{self.record_every}")
        return ("--birds", f"{self.birds}", "--coupling", self.coupling, *spans, *flight)

    @property
    def how(self) -> tuple[str, ...]:
        flags = {"processes": self.processes, "window": self.window, "executor": self.executor}
        return tuple(word for flag, value in flags.items() for word in (f"--{flag}", f"{value}"))

    def __str__(self) -> str:
        spans = "x".join(self.spans) or "standard"
        how = f"{self.processes}processes-window{self.window}-{self.executor}"
        return f"{self.birds}birds-{self.coupling}-{spans}-{how}"


ONE = ("2=1.05",)
THREE = ("1=0.97,1.0,1.04", "2=0.9")

CASES = [
    Case(8, "nearest", (), 60, 7, processes=1, window=1, executor="events"),
    Case(3, "all", ONE, 100, 1, processes=1, window=8, executor="single"),
    Case(2, "all", THREE, 100, 10, processes=1, window=64, executor="events"),
    Case(8, "all", ONE, 40, 1, processes=2, window=1, executor="events"),
    Case(13, "nearest", THREE, 100, 3, processes=2, window=8, executor="events"),
    Case(2, "nearest", (), 100, 10, processes=2, window=64, executor="single"),
    Case(13, "all", THREE, 20, 1, processes=13, window=1, executor="single"),
    Case(13, "all", (), 50, 10, processes=13, window=8, executor="events"),
    Case(13, "nearest", ONE, 100, 10, processes=13, window=64, executor="events"),
    Case(1, "nearest", ("1=0.97,1.0,1.04",), 100, 1, processes=1, window=8, executor="events"),
    Case(1, "all", (), 100, 150, processes=1, window=64, executor="events"),
]


@dataclass(frozen=True)
class Flown:
    """A case that was flown, and where its bag is."""

    case: Case
    bag: Path
    terminal: Terminal


@pytest.fixture(scope="module", params=CASES, ids=str)
def flown(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Flown]:
    case: Case = request.param
    with open_terminal(tmp_path_factory.mktemp("flight")) as terminal:
        bag = terminal.directory / "flight"
        terminal.well("fly", *case.flock, *case.how, "--output", bag)
        yield Flown(case, bag, terminal)


def state_bytes(bag: Path) -> list[tuple[str, int, bytes]]:
    """Topic, time and bytes of every state, in the order of the bag."""
    return [
        (topic, time, data)
        for topic, time, data in Run(bag).bag.messages()
        if topic.endswith("/state")
    ]


def expected_counts(case: Case) -> dict[str, int]:
    """How many messages of each topic a bag without stages has, the grants left aside."""
    rows = case.steps // case.record_every + 1
    birds = [f"/flock/bird_{bird:02d}" for bird in range(1, case.birds + 1)]
    return {
        "/clock": rows,
        "/flock/perturbation": 0,
        **{f"{bird}/wing": 1 for bird in birds},
        **{f"{bird}/state": rows for bird in birds},
    }


def test_the_distributed_flight_equals_the_monolithic_one_to_the_bit(
    flown: Flown, reference: Reference
) -> None:
    done = flown.terminal.run("compare", flown.bag, reference(flown.case.flock), "--json")
    assert done.status == 0, done.stdout
    result = done.json
    assert result["equal"] is True
    assert result["messages"] == flown.case.birds * (
        flown.case.steps // flown.case.record_every + 1
    )
    assert result["first_difference"] is None
    assert set(result["max_difference"].values()) == {0.0}
    # What `compare` says is not taken on trust: the very bytes.
    assert state_bytes(flown.bag) == state_bytes(reference(flown.case.flock))


def test_other_peoples_reader_finds_every_message_due_once_at_its_simulated_time(
    flown: Flown,
) -> None:
    case = flown.case
    configuration = FlockConfiguration(
        birds=case.birds, t_max=float(case.steps), record_every=case.record_every
    )
    stamps = [
        configuration.stamp(step) for step in range(0, case.steps + 1, case.record_every)
    ]  # fmt: skip
    times: dict[str, list[int]] = {}
    with AnyReader([flown.bag]) as reader:
        told = {connection.topic: connection.msgcount for connection in reader.connections}
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            times.setdefault(connection.topic, []).append(time)
            if connection.topic.endswith("/state"):
                stamp = message.header.stamp
                assert stamp.sec * 10**9 + stamp.nanosec == time
                assert message.time == message.step * configuration.dt
                assert configuration.stamp(message.step) == time
                assert np.isfinite(message.position).all()
            elif connection.topic == "/clock":
                assert message.clock.sec * 10**9 + message.clock.nanosec == time
    grants = times.pop("/flock/clock/grant")
    assert told == {**expected_counts(case), "/flock/clock/grant": len(grants)}
    assert grants == sorted(grants)
    for topic, at in times.items():  # those with messages
        assert at == ([0] if topic.endswith("/wing") else stamps), topic


def test_mcaps_own_reader_finds_the_same_messages(flown: Flown) -> None:
    with (flown.bag / "flight_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        counts: Counter[str] = Counter()
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert schema.encoding == "ros2msg"
            assert channel.message_encoding == "cdr"
            assert message.log_time == message.publish_time
            counts[channel.topic] += 1
        (record,) = [m for m in reader.iter_metadata() if m.name == "flock"]
        statistics = reader.get_summary().statistics
    assert counts.pop("/flock/clock/grant") >= 1
    assert counts == +Counter(expected_counts(flown.case))  # of topics that have any
    assert statistics.message_count >= counts.total()
    assert record.metadata["birds"] == str(flown.case.birds)
    assert record.metadata["coupling"] == f'"{flown.case.coupling}"'


STAGED = ("--birds", "4", "--t-max", "90", "--record-every", "3", "--span-ratio", "2=0.98,1.03")


def test_with_stages_every_stage_is_in_the_bag_once_and_the_flight_is_the_same(
    terminal: Terminal, reference: Reference
) -> None:
    bag = terminal.directory / "flight"
    terminal.well("fly", *STAGED, "--processes", 2, "--record-stages", "--output", bag)
    seen: Counter[tuple[int, int, int]] = Counter()
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic.endswith("/stage"):
                message = reader.deserialize(raw, connection.msgtype)
                assert connection.topic == f"/flock/bird_{message.bird:02d}/stage"
                assert len(message.position) == len(message.speed) == 2
                seen[message.bird, message.step, message.stage] += 1
    steps, stages, birds = range(90), range(4), range(1, 5)
    assert seen == Counter((b, s, k) for b in birds for s in steps for k in stages)
    assert terminal.run("compare", bag, reference(STAGED)).status == 0


def test_the_last_stage_values_lead_to_the_next_state(terminal: Terminal) -> None:
    """Stage 0 of a step is the state at its beginning: the stages are those of this flight."""
    bag = terminal.directory / "flight"
    flight = ("--birds", 2, "--t-max", 20, "--record-every", 1, "--record-stages")
    terminal.well("fly", *flight, "--output", bag)
    stages, states = {}, {}
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            bird = connection.topic.rpartition("/")[0]
            if connection.topic.endswith("/stage") and message.stage == 0:
                stages[bird, message.step] = message
            elif connection.topic.endswith("/state"):
                states[bird, message.step] = message
    for at, stage in stages.items():
        for name in ("position", "speed", "circulation"):
            assert getattr(stage, name).tobytes() == getattr(states[at], name).tobytes(), (at, name)


def test_two_flights_of_a_configuration_have_the_same_bytes_in_every_state(
    terminal: Terminal,
) -> None:
    flight = ("--birds", 5, "--t-max", 200, "--span-ratio", "4=0.96,1.04", "--processes", 2)
    bags = [terminal.directory / name for name in ("first", "second")]
    for bag in bags:
        terminal.well("fly", *flight, "--output", bag)
    first, second = map(state_bytes, bags)
    assert len(first) == 5 * 21
    assert first == second


def test_a_flight_that_is_not_the_same_is_told(terminal: Terminal, reference: Reference) -> None:
    one = reference(("--birds", "3", "--t-max", "50"))
    other = reference(("--birds", "3", "--t-max", "50", "--span-ratio", "2=1.0000001"))
    done = terminal.run("compare", one, other, "--json")
    assert done.status == 1
    assert done.json["equal"] is False
    assert done.json["first_difference"] is not None
    assert max(done.json["max_difference"].values()) > 0.0

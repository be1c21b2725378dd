# SPDX-License-Identifier: Apache-2.0
"""Flights that another program recorded or converted, such as rosbag2 and rosbags.

Their bags lack the records of Flock. A recording of a live flight also has the times at which the
messages were received, run ids and epochs, and rows that were flown again after a fault.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.state import BILLION, State
from flock_sim.messages.state_layout import members_of
from flock_sim.messages.types import Push, Time, Wing
from flock_sim.recording.flight_bag import (
    CONFIGURATION_RECORD,
    checked_push,
    granted_configuration,
)
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.row_assembler import Row

FEW = 10
"""Number of states whose times are checked."""


def needed_repair(bag: BagReader) -> str | None:
    """Return what a flight in `bag` needs before it can be read as a run; None: nothing.

    A flight whose messages were converted one by one can be read: a grant has the configuration.
    """
    first = topics.state_topic(1)
    if CONFIGURATION_RECORD in bag.records or first not in bag.topics:
        return None
    if topics.GRANT_TOPIC not in bag.topics:
        return (
            f"{bag.path}: another program wrote this bag, without the configuration of the flight;"
            f" give it: ./flock repair {bag.path} --config FILE"
        )
    # The first times may agree by chance: a recorder that follows /clock begins at 0, too.
    for _, time, data in islice(bag.messages([first]), FEW):
        with suppress(ValueError):
            if State.envelope(data) != (0, 0) or _stamp(State.decode(data)) != time:
                return (
                    f"{bag.path}: another program recorded this flight, with the times at which it"
                    f" received the messages; make a run of it: ./flock repair {bag.path}"
                )
    return None


class ForeignFlight:
    """The rows and pushes of a flight that another program recorded.

    `missing_steps` are the recorded steps between complete rows that lack a state, and `left_out`
    is the number of messages of the flock that are not used. Both are known after `rows`.
    """

    def __init__(self, bag: BagReader, given: FlockConfiguration | None = None) -> None:
        """Take the configuration `given`, or that of the first grant.

        Raises FlockError without a configuration, and for a free flight, which no repetition
        completes.
        """
        self.configuration, factor = (given, 0.0) if given else granted_configuration(bag)
        if factor or topics.ages_topic(1) in bag.topics:
            raise FlockError(
                f"{bag.path}: a free flight that another program recorded can't be repaired:"
                " record it with ./flock fly"
            )
        self.path = bag.path
        self.missing_steps: list[int] = []
        self.left_out = 0
        self.pushes: dict[int, Push] = {}
        self._bag = bag
        self._run_id: int | None = None

    def rows(self) -> Iterator[Row]:
        """Yield each complete row once, in order. Memory: the rows that are not complete yet.

        Raises FlockError if a wing is not that of the configuration.
        """
        birds = range(1, self.configuration.birds + 1)
        bird_of = {topics.state_topic(bird): bird for bird in birds}
        wing_of = {topics.wing_topic(bird): bird for bird in birds}
        wanted = {*bird_of, *wing_of, topics.PERTURBATION_TOPIC}
        streams = [stream for stream in self._bag.streams if stream.topic in wanted]
        begun: defaultdict[int, dict[int, bytes]] = defaultdict(dict)
        last = -self.configuration.record_every
        for topic, _, data in self._bag.by_time(streams):
            if topic in wing_of:
                self._check_wing(wing_of[topic], data)
            elif topic == topics.PERTURBATION_TOPIC:
                self._keep_push(data)
            elif (step := self._step_of(data)) is None:
                self.left_out += 1
            elif step > last:
                begun[step][bird_of[topic]] = State.opened(data)
                if len(begun[step]) == len(birds):
                    every = self.configuration.record_every
                    self.missing_steps.extend(range(last + every, step, every))
                    states = begun[step]
                    yield _row(self.configuration, step, [states[bird] for bird in birds])
                    last = step
                    begun = defaultdict(dict, {k: row for k, row in begun.items() if k > last})

    def _step_of(self, data: bytes) -> int | None:
        """Return the step of a recorded state; None if it is not one of this flight.

        Raises FlockError if it has another time than in the configuration.
        """
        flown = self.configuration
        if members_of(data) != flown.members:
            return None
        run_id, _ = State.envelope(data)
        if self._run_id is None:
            self._run_id = run_id
        state = State.decode(data)
        if run_id != self._run_id or state.step % flown.record_every or state.step > flown.steps:
            return None
        if flown.stamp(state.step) != _stamp(state):
            raise FlockError(
                f"{self.path}: step {state.step} is at {_stamp(state) / BILLION:.12g} s, and at"
                f" {flown.stamp(state.step) / BILLION:.12g} s by the configuration; give that of"
                " the flight by --config FILE"
            )
        return state.step

    def _check_wing(self, bird: int, data: bytes) -> None:
        with suppress(ValueError):
            flown, told = Wing.decode(data).span_ratio, self.configuration.span_ratio[bird - 1]
            if not np.array_equal(flown, told):
                raise FlockError(
                    f"{self.path}: {topics.bird_name(bird)} has the span ratio {flown}, and "
                    f"the configuration has {told}; give that of the flight by --config FILE"
                )

    def _keep_push(self, data: bytes) -> None:
        try:
            push = checked_push(data, self.configuration)
        except FlockError:
            self.left_out += 1
        else:
            self.pushes.setdefault(push.number, push)


def write_flight(flight: ForeignFlight, output: Path, *, replace: bool = False) -> int:
    """Write a flight to a bag in the form of `reference`; return the number of its rows.

    `output` and `replace` are as in `recording`. Raises FlockError if there is no complete row.
    """
    configuration, count = flight.configuration, 0
    with recording(
        output, configuration, grants=False, live=True, replace=replace, machines=()
    ) as run:
        try:
            for bird in range(1, configuration.birds + 1):
                wing = Wing(0, bird, configuration.span_ratio[bird - 1])
                run.write(topics.wing_topic(bird), 0, wing.encode())
            for row in flight.rows():
                run.write_row(row)
                count += 1
            if not count:
                raise FlockError(
                    f"{flight.path}: no recorded step is complete and fits the configuration; give"
                    " that of the flight by --config FILE"
                )
            for push in flight.pushes.values():
                run.write_perturbation(push)
        except BaseException:
            run.bag.discard()
            raise
    return count


def _row(configuration: FlockConfiguration, step: int, states: list[bytes]) -> Row:
    return Row(step, [], [], Time.at(configuration.stamp(step)).encode(), states)


def _stamp(state: State) -> int:
    return state.seconds * BILLION + state.nanoseconds

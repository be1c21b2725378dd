# SPDX-License-Identifier: Apache-2.0
"""Compares two runs: whether they are equal, where they first differ, and by how much."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Literal

import numpy as np
import numpy.typing as npt

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.perturbation import in_order
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.state import ARRAYS, FRAMES, MEANS, VALUES
from flock_sim.messages.state_layout import layout_of, same_head, step_of, steps_of, values_of
from flock_sim.messages.types import BILLION, State
from flock_sim.physics.arrays import FloatArray
from flock_sim.recording.own_parts import LAW, digests
from flock_sim.recording.run import Run
from flock_tools.runs.difference import Difference, distance, other_bits
from flock_tools.runs.pairing import Ticks, by_step, pairs
from flock_tools.runs.verified_states import VerifiedStates

BLOCK = 2048
"""Number of pairs of states that are compared at once."""

SAME_TIME = 1e-6
"""Distance in time below which two states are of the same time, in the shorter time step."""


Unlike = tuple[str, int | None, tuple[object, object]]
"""A field, the member or None, and its two values."""


@dataclass
class Comparison:
    """The result of a comparison of two runs. It is updated as they are read."""

    configuration: list[Difference] = field(default_factory=list)
    wings: list[Difference] = field(default_factory=list)
    state: Difference | None = None
    """The earliest difference between states; at one time, that of the lowest bird."""
    messages: int = 0
    """Number of state messages that both runs have."""
    comparable: int = 0
    """Number of those that have the same number of members in both runs."""
    different: int = 0
    """Number of those that differ, by more than the tolerance if one is given."""
    missing: list[int] = field(default_factory=lambda: [0, 0])
    """For each run: the number of state messages that only the other run has."""
    max_difference: dict[str, float] = field(default_factory=lambda: dict.fromkeys(VALUES, 0.0))
    """Largest absolute difference of each field; inf if one value is nan or infinite.

    Means are compared, too, but their differences are not listed.

    It has no meaning if no message is `comparable`.
    """

    @property
    def first_difference(self) -> Difference | None:
        """The likeliest cause of the rest: a difference of configuration, wing or state."""
        return next(chain(self.configuration, self.wings), self.state)

    @property
    def equal(self) -> bool:
        """Whether the runs are equal."""
        return self.first_difference is None

    def as_json(self) -> dict[str, object]:
        """Return plain values; an infinite or unknown difference becomes None for JSON."""
        return {
            "equal": self.equal,
            "messages": self.messages,
            "first_difference": _json(self.first_difference),
            "max_difference": {
                name: value if self.comparable and np.isfinite(value) else None
                for name, value in self.max_difference.items()
            },
            "first_state_difference": _json(self.state),
            "configuration": [difference.field for difference in self.configuration],
            "different_messages": self.different,
            "missing_messages": self.missing,
        }


def compare(
    first: Run,
    second: Run,
    tolerance: float | None = None,
    show: Callable[[int], None] = lambda step: None,
) -> Comparison:
    """Compare two runs bit for bit, or the arrays of their states to within `tolerance`.

    Run ids, grants, clock and diagnostics are not compared, because they only describe how the
    flock was flown. Perturbations requested in flight are not compared either, because states show
    their effect. States of a bird are compared at equal times. `show` is called at intervals with
    the step reached. Memory is bounded.

    Raises FlockError if a bag can't be read, or its states do not have the digest in it.
    """
    result = Comparison(list(_configurations(first, second)), list(_wings(first, second)))
    birds = range(1, max(run.configuration.birds for run in (first, second)) + 1)
    bird_of = {topics.state_topic(bird): bird for bird in birds}
    ticks = _ticks(first.configuration, second.configuration)
    states = _States(result, tolerance, (first, second), bird_of, ticks)
    verified = VerifiedStates(first), VerifiedStates(second)
    for topic, left, right in pairs(*verified, list(states.bird_of), ticks=ticks):
        if left is None or right is None:
            states.miss(topic, left, right)
            continue
        result.messages += 1
        if left == right:
            result.comparable += 1
        else:
            states.compare(topic, left, right)
        if result.messages % BLOCK == 0:
            show(step_of(left))
    states.finish()
    for source in verified:
        source.check()
    if result.messages == 0 and result.equal:
        empty = [str(run.path) for run in (first, second) if run.bag.last_time is None]
        raise FlockError(
            f"{' and '.join(empty) or 'the runs'}: there are no states to compare; "
            "name bags of flights with recorded states"
        )
    return result


def _ticks(first: FlockConfiguration, second: FlockConfiguration) -> Ticks:
    """Return the times of the steps of two flights, for `pairs`."""
    if first.dt == second.dt:
        return by_step, by_step
    unit = SAME_TIME * min(first.dt, second.dt)
    return (
        lambda step: round(first.time(step) / unit),
        lambda step: round(second.time(step) / unit),
    )


class _States:
    """Compares pairs of states of different bytes, many at once if their layouts are equal."""

    def __init__(
        self,
        result: Comparison,
        tolerance: float | None,
        runs: Sequence[Run],
        bird_of: Mapping[str, int],
        ticks: Ticks,
    ) -> None:
        self.bird_of = bird_of
        self._result = result
        self._tolerance = tolerance
        self._runs = runs
        self._ticks = ticks
        self._earliest: tuple[int, int] | None = None  # time and bird of the result's state
        self._block: list[tuple[str, bytes, bytes]] = []
        self._members = 0  # of the states in the block
        spans = {(run.configuration.record_every, run.configuration.dt) for run in runs}
        # Means over other steps are other quantities.
        self._names = ARRAYS if len(spans) == 1 else VALUES

    def miss(self, topic: str, left: bytes | None, right: bytes | None) -> None:
        """Register a state that one run lacks."""
        lacks = 0 if left is None else 1
        data = left or right or b""
        self._result.missing[lacks] += 1
        if self._is_earliest(1 - lacks, topic, step_of(data)):
            state = self._runs[1 - lacks].decode(topic, data)
            self._note("missing", topic, state, None, (lacks == 1, lacks == 0), side=1 - lacks)

    def compare(self, topic: str, left: bytes, right: bytes) -> None:
        """Compare two states of one bird at one step. Raises FlockError if one is no state."""
        layout = layout_of(left)
        members = layout.members if layout and not layout.forcing else 0
        if members and len(left) == len(right) and same_head(left, right):
            if members != self._members or len(self._block) == BLOCK:
                self.finish()
                self._members = members
            self._block.append((topic, left, right))
            self._result.comparable += 1
            return
        one, other = (
            run.decode(topic, data) for run, data in zip(self._runs, (left, right), strict=True)
        )
        self._result.comparable += len(one.position) == len(other.position)
        heads = _unlike_heads(one, other) if self._ticks[0] is by_step else ()
        unlike = [*heads, *self._unlike_arrays(one, other)]
        if unlike:
            self._result.different += 1
            name, member, pair = unlike[0]
            self._note("state", topic, one, name, pair, member)

    def finish(self) -> None:
        """Compare the collected states."""
        if not self._block:
            return
        first = values_of([left for _, left, _ in self._block], self._members)
        second = values_of([right for _, _, right in self._block], self._members)
        apart = np.stack(
            [self._apart(name, first[:, k], second[:, k]) for k, name in enumerate(self._names)],
            axis=1,
        )
        rows = np.flatnonzero(apart.any(axis=(1, 2)))
        self._result.different += len(rows)
        if len(rows):
            steps = steps_of([self._block[row][1] for row in rows])
            earliest = rows[steps == steps.min()]
            row = min(earliest, key=lambda row: self.bird_of[self._block[row][0]])
            k, m = (int(at) for at in np.argwhere(apart[row])[0])
            topic, left, _ = self._block[row]
            pair = float(first[row, k, m]), float(second[row, k, m])
            self._note("state", topic, State.decode(left), ARRAYS[k], pair, m + 1)
        self._block.clear()

    def _unlike_arrays(self, one: State, other: State) -> Iterator[Unlike]:
        """Yield the first difference of each array of two states."""
        for name in (*self._names, "forcing_state"):
            first, second = getattr(one, name), getattr(other, name)
            if name in MEANS and 0 in (len(first), len(second)):
                continue  # one was recorded by a version without means
            if len(first) != len(second):
                yield name, None, (first.tolist(), second.tolist())
                continue
            for m in np.flatnonzero(self._apart(name, first, second))[:1]:
                member = int(m) % len(one.position) + 1
                yield name, member, (float(first[m]), float(second[m]))

    def _apart(self, name: str, first: FloatArray, second: FloatArray) -> npt.NDArray[np.bool_]:
        """Return where two arrays differ. Updates the largest difference."""
        gap = distance(first, second)
        largest = self._result.max_difference
        if name in largest:
            largest[name] = max(largest[name], float(gap.max(initial=0.0)))
        return other_bits(first, second) if self._tolerance is None else gap > self._tolerance

    def _is_earliest(self, side: int, topic: str, step: int) -> bool:
        """Return whether no earlier difference is registered. `step` is one of the run `side`."""
        place = self._ticks[side](step), self.bird_of[topic]
        return self._earliest is None or place < self._earliest

    def _note(
        self,
        kind: Literal["state", "missing"],
        topic: str,
        state: State,
        name: str | None,
        values: tuple[object, object],
        member: int | None = None,
        side: int = 0,
    ) -> None:
        """Register a difference at a state of the run `side`. The earliest is kept."""
        if not self._is_earliest(side, topic, state.step):
            return
        bird = self.bird_of[topic]
        self._earliest = self._ticks[side](state.step), bird
        self._result.state = Difference(
            kind, values, name, topic, bird, state.step, state.time, member
        )


def _unlike_heads(one: State, other: State) -> Iterator[Unlike]:
    """Yield the differing fields of two states before their arrays, by message field name."""
    stamps = [state.seconds * BILLION + state.nanoseconds for state in (one, other)]
    if stamps[0] != stamps[1]:
        yield "header.stamp", None, (stamps[0], stamps[1])
    if one.frame != other.frame and not {one.frame, other.frame} <= FRAMES:
        yield "header.frame_id", None, (one.frame, other.frame)
    if one.step != other.step:
        yield "step", None, (one.step, other.step)
    if struct.pack("<d", one.time) != struct.pack("<d", other.time):
        yield "time", None, (one.time, other.time)


def _configurations(first: Run, second: Run) -> Iterator[Difference]:
    """Yield the keys in which the configurations differ. Lists are compared by their meaning."""
    one, other = first.configuration, second.configuration
    values, others = one.parameters(), other.parameters()
    spans = values.pop("span_ratios"), others.pop("span_ratios")
    pushes = values.pop("perturbations"), others.pop("perturbations")
    links = values.pop("links"), others.pop("links")
    for key, value in values.items():
        if value != others[key]:
            yield Difference("configuration", (value, others[key]), key)
    # "4=1", "4=1.0" and no entry describe the same flock.
    if one.birds == other.birds and not np.array_equal(one.span_ratio, other.span_ratio):
        yield Difference("configuration", spans, "span_ratios")
    if pushes[0] != pushes[1] and in_order(one.pushes) != in_order(other.pushes):
        yield Difference("configuration", pushes, "perturbations")
    if links[0] != links[1] and not _same_links(one, other):
        yield Difference("configuration", links, "links")
    laws, other_laws = digests(first.own_parts, LAW), digests(second.own_parts, LAW)
    for name in sorted(laws.keys() & other_laws.keys()):
        if laws[name] != other_laws[name]:
            yield Difference("configuration", (laws[name], other_laws[name]), f"law {name}")


def _same_links(one: FlockConfiguration, other: FlockConfiguration) -> bool:
    """Return whether the links are equivalent: "exact" and no entry are equivalent."""
    if one.link_table.plain or other.link_table.plain:
        return one.link_table.plain and other.link_table.plain
    if (one.birds, one.coupling, one.members) != (other.birds, other.coupling, other.members):
        return False
    birds = range(1, one.birds + 1)
    plans = [flock.link_table.plan(birds, flock.members) for flock in (one, other)]
    return np.array_equal(plans[0].links, plans[1].links) and np.array_equal(
        plans[0].faults, plans[1].faults
    )


def _wings(first: Run, second: Run) -> Iterator[Difference]:
    """Yield the first difference between the wings of each bird."""
    one, other = first.wings(), second.wings()
    for bird in sorted(one.keys() | other.keys()):
        ratios, others = one.get(bird), other.get(bird)
        values: tuple[object, object]
        member = None
        if ratios is None or others is None or len(ratios) != len(others):
            values = _listed(ratios), _listed(others)
        elif (unlike := np.flatnonzero(other_bits(ratios, others))).size:
            m = int(unlike[0])
            values, member = (float(ratios[m]), float(others[m])), m + 1
        else:
            continue
        topic = topics.wing_topic(bird)
        yield Difference("wing", values, "span_ratio", topic, bird, member=member)


def _listed(ratios: FloatArray | None) -> object:
    return None if ratios is None else ratios.tolist()


def _json(difference: Difference | None) -> dict[str, object] | None:
    return None if difference is None else difference.as_json()

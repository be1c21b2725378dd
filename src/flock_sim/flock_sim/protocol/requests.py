# SPDX-License-Identifier: Apache-2.0
"""How far the clock lets birds fly, and what users ask of a run: pauses, steps and pushes."""

from __future__ import annotations

from dataclasses import dataclass, field

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.rejection import IMPOSSIBLE, REPEATED
from flock_sim.messages.types import Push


@dataclass
class Pause:
    """The step that a run may not go beyond. Before the first grant it is not known yet."""

    at: int | None = None
    """The step; None: no pause, or not known yet."""
    steps: int = 0
    """Steps to fly from where the run begins or continues, before a pause; 0: none."""
    pending: bool = False
    """Whether to pause where the run begins or continues."""

    def ask(self, granted: int, known: bool) -> None:
        """Pause at the furthest step `granted`; if none is `known`, where the run begins."""
        self.at, self.steps, self.pending = granted, 0, not known

    def end(self) -> None:
        """Continue."""
        self.at, self.steps, self.pending = None, 0, False

    def take_steps(self, count: int, granted: int, known: bool) -> None:
        """Fly `count` more steps, and then pause."""
        if known:
            self.at = max(granted, self.at or 0) + count
        else:
            self.steps += count

    def begin(self, granted: int) -> None:
        """Apply what was asked for before the first grant, which is now known."""
        if self.steps or self.pending:
            self.at = granted + self.steps
            self.steps, self.pending = 0, False


@dataclass
class Window:
    """How far birds may fly: `size` steps beyond the slowest, `ahead` steps beyond the disk."""

    size: int
    ahead: int
    granted: int = 0
    """The last step granted in this epoch."""
    furthest: int = 0
    """The furthest step ever granted."""
    pause: Pause = field(default_factory=Pause)

    def begin(self, step: int) -> None:
        """Begin an epoch at the last step on disk."""
        self.granted = step
        self.furthest = max(self.furthest, step)

    def extend(self, reached: int, saved: int | None, end: int) -> bool:
        """Extend the grant; return whether it goes further than before.

        All birds have `reached` a step; `saved` is on disk (None: nothing is recorded).
        """
        limit = min(reached + self.size, end)
        if saved is not None:
            limit = min(limit, max(saved, 0) + self.ahead)
        if self.pause.at is not None:
            limit = min(limit, self.pause.at)
        if limit <= self.granted:
            return False
        self.begin(limit)
        return True


def step_of_push(step: int, granted: int, end: int) -> int:
    """Return the step of a push requested at `step`; 0 requests the soonest possible step.

    Raises FlockError if that step is already `granted` or is after the `end` of the flight.
    """
    soonest = granted + 1
    if soonest > end:
        raise FlockError(
            f"too late to push: birds already have a grant up to step {granted}, where the "
            "flight ends; fly longer, or push earlier"
        )
    if step and not soonest <= step <= end:
        raise FlockError(
            f"step = {step}: must be {soonest}..{end}, since birds already have a grant up "
            f"to {granted} and the flight ends at {end}; or 0 for the earliest possible step"
        )
    return step or soonest


def refuses_push(push: Push, configuration: FlockConfiguration, saved: int) -> str:
    """Return why a push that was requested in flight can't be flown, or "".

    `saved` is the last step on disk: a recorded step can't be pushed any more.
    """
    try:
        push.check(configuration)
    except FlockError:
        return IMPOSSIBLE
    return "" if push.step > saved else REPEATED

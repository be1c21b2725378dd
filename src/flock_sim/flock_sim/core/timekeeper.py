# SPDX-License-Identifier: Apache-2.0
"""How the clock keeps a flock together, as a state machine: progress in, leave and time out.

The flock may go `window` steps beyond its slowest bird, and never further beyond what is on disk
than the messages on the way to the recorder can hold. When somebody has died and come back, or this
clock is itself a new one, the flock is sent back to what is on disk: a new epoch.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.messages import Checkpoint, Grant, Progress, Push, Time
from flock_sim.core.perturbation import Perturbation
from flock_sim.core.stage_inbox import FOREIGN, REACH, REPEATED, STALE
from flock_sim.core.terms import terms
from flock_sim.core.topics import RECORDER, bird_name, steps_ahead
from flock_sim.errors import FlockError

ABSENT = -2
"""The step of somebody who has not been heard of. -1 is a bird that is there and has not heard its
neighbours, or a recorder that is there and has recorded nothing."""

UNKNOWN = "from nobody of this flock"

Message = Grant | Time | Checkpoint | Push


def new_run_id() -> int:
    """Return a run id that nobody else has: 1 .. 2**63 - 1, since ROS parameters are signed."""
    return secrets.randbelow(2**63 - 1) + 1


@dataclass
class Rewinds:
    """What recovering has cost so far: how many times, and the steps that were flown again."""

    count: int = 0
    steps: int = 0


class Timekeeper:
    """The clock of one run. Feed it Progress; send the messages it returns, in order.

    >>> clock = Timekeeper(FlockConfiguration(birds=1, t_max=9.0), run_id=7, window=4, record=False)
    >>> [type(message).__name__ for message in clock.first_messages]
    ['Grant', 'Checkpoint']
    >>> clock.receive(Progress(7, 0, 1, "bird_01"))[-1].step
    4
    """

    def __init__(
        self,
        configuration: FlockConfiguration,
        run_id: int,
        window: int,
        record: bool,
        record_stages: bool = False,
        epoch: int = 1,
        factor: float = 0.0,
    ) -> None:
        """Begin a run of `configuration` under `run_id`; `record`: there will be a recorder.

        `epoch` is the first one; a clock that takes the place of another begins with a later one.
        `factor` is the real-time factor of a free flight, in which nobody is held by the window.
        """
        self._configuration = configuration
        self._window = configuration.steps if factor else window
        self.free = factor > 0.0
        """Whether birds step by their own timers: such a flight can't be operated."""
        self.lost = False
        """Whether a free flight would have had to go back, which it can't."""
        self._ahead = steps_ahead(configuration, record_stages)
        self._terms = terms(configuration, factor)
        self.run_id = run_id
        self.epoch = epoch
        self.end = configuration.steps
        """The last step: that of the configuration, or where the run was stopped."""
        self.moves = 0
        """How often anybody has moved: a run in which this stays stands still."""
        self.rewinds = Rewinds()
        self.ignored_for: Counter[str] = Counter()
        """How many messages changed nothing, by the reason."""
        birds = [bird_name(bird) for bird in range(1, configuration.birds + 1)]
        self._birds = frozenset(birds)
        self._lives: dict[str, set[int]] = {
            name: set() for name in [*birds, *([RECORDER] if record else [])]
        }
        self._record = record
        self._pause_at: int | None = None
        self._stopping = False  # to be stopped once all are there
        self._perturbation = 0
        self._reached_before = 0  # the step that was reached when the last rewind came
        self._first: int | None = None  # the step that this clock began at
        self._begin_epoch()

    def _begin_epoch(self) -> None:
        self.step = ABSENT
        """The step that every bird has reached; below 0 before they have heard each other."""
        self._reached = dict.fromkeys(self._lives, ABSENT)
        # How many birds have reached each step: few steps, however many birds.
        self._birds_at = Counter(self._reached[name] for name in self._birds)
        self._heard: set[str] = set()  # since anybody has moved
        self._granted = 0
        self._told = -1  # the last step whose time was told, or that is on disk
        self._checkpoint = ABSENT  # the step that was on disk when the epoch began

    @property
    def first_messages(self) -> list[Message]:
        """The messages that begin an epoch: everybody to the checkpoint."""
        messages: list[Message] = [self.grant]
        if not self._record:
            messages.append(Checkpoint.of_start(self.run_id, self.epoch))
        return messages

    @property
    def grant(self) -> Grant:
        """The leave that was given last."""
        return self._grant(self._granted)

    @property
    def release(self) -> Grant:
        """The message that ends the run, leave beyond its end: nobody needs the birds any more."""
        return self._grant(self.end + 1)

    @property
    def finished(self) -> bool:
        """Whether the last step is reached, and on disk where it is to be recorded."""
        if not self._record:
            return self.step >= self.end
        last_recorded = self.end - self.end % self._configuration.record_every
        # Where an epoch begins with everything on disk, birds may have been let go already.
        flown = self.step >= self.end or self._checkpoint >= last_recorded
        return flown and self.saved >= last_recorded

    @property
    def begun(self) -> bool:
        """Whether all are there, and every bird has heard its neighbours."""
        return self.step >= 0 and self._reached.get(RECORDER) != ABSENT

    @property
    def paused(self) -> bool:
        """Whether the flock has come to where it was told to pause."""
        return self._pause_at is not None and self.step >= self.pauses_at

    @property
    def pauses_at(self) -> int:
        """The step that the flock pauses at; its end where it does not."""
        return self.end if self._pause_at is None else min(self._pause_at, self.end)

    @property
    def lag(self) -> int:
        """Steps that the flock is ahead of what is on disk; 0 where nothing is recorded."""
        return max(0, self.step - max(self.saved, 0)) if self._record else 0

    @property
    def saved(self) -> int:
        """The last step that is on disk; -1 or less for none."""
        return self._reached[RECORDER]

    @property
    def where(self) -> str:
        """Where the run is, in words."""
        return f"at step {self.step} of {self.end}" if self.begun else "to begin"

    @property
    def waiting_for(self) -> list[str]:
        """Who has to move before the run can go on; nobody in a pause."""
        if self.paused:
            return []
        absent = [name for name, step in self._reached.items() if step == ABSENT]
        if absent:
            return absent
        if self.step < max(self._granted, 1):
            # Who waits says so again and again; who is silent is what they wait for.
            silent = [name for name, _ in self._birds_reached() if name not in self._heard]
            behind = [name for name, step in self._birds_reached() if step == self.step]
            return silent if silent and self._heard else behind
        return [RECORDER] if self._record else []

    def receive(self, progress: Progress) -> list[Message]:
        """Take somebody's progress; what is not of this run, or not new, changes nothing."""
        if progress.run_id != self.run_id:
            return self._ignore(FOREIGN)
        lives = self._lives.get(progress.who)
        if lives is None:
            return self._ignore(UNKNOWN)
        came_back = bool(lives) and progress.life not in lives
        lives.add(progress.life)
        if progress.epoch > self.epoch + REACH:
            return self._ignore(REPEATED)
        if came_back or progress.epoch > self.epoch:
            self.epoch = max(self.epoch, progress.epoch)
            return self.rewind()
        if progress.epoch < self.epoch:
            return self._ignore(STALE)
        if progress.step > self.end:
            return self._ignore(REPEATED)
        self._heard.add(progress.who)
        if progress.step <= self._reached[progress.who]:
            return []
        first = self._reached[progress.who] == ABSENT
        self._reach(progress.who, progress.step)
        self.moves += 1
        self._heard.clear()
        if progress.who == RECORDER and first:
            self._told = self._checkpoint = progress.step
            self._granted = max(0, progress.step)
        self.step = min(self._birds_at)
        if not self.begun:
            return []
        if max(self._birds_at) > self._granted:
            return self.rewind()  # by the leave of another clock, in an epoch of the same number
        self._count_steps_lost()
        return [*self._times(), *(self.stop() if self._stopping else self._grants())]

    def rewind(self) -> list[Message]:
        """Send everybody back to what is on disk, under a new epoch."""
        if self.begun:
            self._reached_before = self.step
        self.lost = self.free and self._granted > 0
        self.rewinds.count += 1
        self.epoch += 1
        self.moves += 1
        self._begin_epoch()
        return self.first_messages

    def pause(self) -> None:
        """Give no more leave than was given."""
        self._pause_at = self._granted

    def resume(self) -> list[Grant]:
        """Go on after a pause."""
        self._pause_at = None
        return self._grants() if self.begun else []

    def take_steps(self, count: int) -> list[Grant]:
        """Give leave for `count` steps more, and then pause."""
        self._pause_at = max(self._granted, self._pause_at or 0) + count
        return self._grants() if self.begun else []

    def perturb(
        self, bird: int, member: int, step: int, position: float, speed: float
    ) -> tuple[int, list[Message]]:
        """Push a bird (of member 0: all of them) at `step`, or as soon as can be if that is 0.

        Returns the step, and the messages that begin the epoch in which it is flown. Raises
        FlockError where it can't be.
        """
        configuration = self._configuration
        if not self._record:
            raise FlockError(
                "nothing is recorded, so a push would be forgotten: fly with a recorder"
            )
        if not (position or speed):
            raise FlockError("position = 0 and speed = 0 push nobody: give one of them")
        if not self.begun:
            raise FlockError("the flock is not flying yet, or again: ask once more when it is")
        soonest = self._granted + 1
        step = step or soonest
        if step < soonest:
            raise FlockError(
                f"step = {step}: must be {soonest} or more, since birds have leave to fly up to "
                f"{self._granted}; or 0 for as soon as can be"
            )
        members = [member] if member else range(1, configuration.members + 1)
        pushes = [Perturbation(step, bird, m, position, speed) for m in members]
        for push in pushes:
            push.check(configuration.birds, configuration.members, self.end)
        # By the number of the epoch that it begins, it is told from those of any clock before.
        numbered = list(enumerate(pushes, start=self.epoch + 1))
        self.epoch += len(pushes) - 1
        self._perturbation = self.epoch + 1
        asked: list[Message] = [Push.of(self.run_id, number, push) for number, push in numbered]
        return step, asked + self.rewind()

    def stop(self) -> list[Message]:
        """End the run where leave ends; during a rewind: where it would go on."""
        self._pause_at = None
        self._stopping = not self.begun
        if self._stopping:
            return []
        self.end = self._granted
        return [self.grant]

    @property
    def distance(self) -> int:
        """How many steps the flock has come since this clock began."""
        return max(0, self.step - (self._first or 0))

    def _count_steps_lost(self) -> None:
        if self._first is None:
            self._first = self.step
        if self._reached_before:
            self.rewinds.steps += max(0, self._reached_before - self.step)
            self._reached_before = 0

    def _reach(self, who: str, step: int) -> None:
        before = self._reached[who]
        self._reached[who] = step
        if who != RECORDER:
            self._birds_at[step] += 1
            self._birds_at[before] -= 1
            if not self._birds_at[before]:
                del self._birds_at[before]

    def _ignore(self, reason: str) -> list[Message]:
        self.ignored_for[reason] += 1
        return []

    def _birds_reached(self) -> Iterable[tuple[str, int]]:
        return ((name, step) for name, step in self._reached.items() if name != RECORDER)

    def _times(self) -> list[Time]:
        """Tell the time of every recorded step that the whole flock has reached."""
        every = self._configuration.record_every
        steps = range(self._told + 1, self.step + 1)
        self._told = max(self._told, self.step)
        return [Time.at(self._configuration.stamp(step)) for step in steps if step % every == 0]

    def _grants(self) -> list[Grant]:
        limit = min(self.step + self._window, self.end)
        if self._record:
            limit = min(limit, max(self.saved, 0) + self._ahead)
        if self._pause_at is not None:
            limit = min(limit, self._pause_at)
        if limit <= self._granted:
            return []
        self._granted = limit
        return [self.grant]

    def _grant(self, step: int) -> Grant:
        return Grant(
            self.run_id,
            step,
            self.end,
            self._configuration.dt,
            self.epoch,
            self._terms,
            self._perturbation,
        )

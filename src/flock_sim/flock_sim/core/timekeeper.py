# SPDX-License-Identifier: Apache-2.0
"""How the clock keeps a flock together, as a state machine: progress in, leave and time out.

The flock may go `window` steps beyond its slowest bird, and never further beyond what is on disk
than the messages on the way to the recorder can hold.
"""

from __future__ import annotations

import secrets

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.messages import Grant, Progress, Time
from flock_sim.core.topics import RECORDER, bird_name, steps_ahead


def new_run_id() -> int:
    """Return a run id that nobody else has: 1 .. 2**63 - 1, since ROS parameters are signed."""
    return secrets.randbelow(2**63 - 1) + 1


class Timekeeper:
    """The clock of one run. Feed it Progress; send the Grants and Times it returns, in order.

    >>> clock = Timekeeper(FlockConfiguration(birds=1, t_max=9.0), run_id=7, window=4, record=False)
    >>> clock.first_grant.step
    0
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
    ) -> None:
        """Begin a run of `configuration` under `run_id`; `record`: there will be a recorder."""
        self._configuration = configuration
        self._window = window
        self._ahead = steps_ahead(configuration, record_stages)
        self.run_id = run_id
        self.epoch = 1
        birds = (bird_name(bird) for bird in range(1, configuration.birds + 1))
        self._reached: dict[str, int | None] = dict.fromkeys(birds)
        self._saved: int | None = None
        self._record = record
        self._granted = 0
        self._told = -1

    @property
    def first_grant(self) -> Grant:
        """The message that begins the run: everybody to the start."""
        return self._grant(0)

    @property
    def step(self) -> int:
        """The step that every bird has reached; -1 before all are there."""
        reached = [-1 if step is None else step for step in self._reached.values()]
        return min(reached)

    @property
    def finished(self) -> bool:
        """Whether the last step is reached, and on disk where it is to be recorded."""
        end = self._configuration.steps
        last_recorded = end - end % self._configuration.record_every
        saved = self._saved if self._saved is not None else -1
        return self.step == end and (not self._record or saved >= last_recorded)

    @property
    def state(self) -> tuple[int, ...]:
        """Everything that changes as the run goes on: a run whose state stays stands still."""
        saved = -2 if self._saved is None else self._saved
        return (saved, *(-1 if step is None else step for step in self._reached.values()))

    @property
    def stage_of_run(self) -> str:
        """Where the run is, in words."""
        if self.step < 0 or (self._record and self._saved is None):
            return "to begin"
        return f"at step {self.step} of {self._configuration.steps}"

    @property
    def waiting_for(self) -> list[str]:
        """Who has to move before the run can go on."""
        reached = {name: -1 if step is None else step for name, step in self._reached.items()}
        slowest = self.step
        if slowest < self._granted or slowest < 0:
            return [name for name, step in reached.items() if step == slowest]
        return [RECORDER] if self._record else []

    def receive(self, progress: Progress) -> list[Grant | Time]:
        """Take somebody's progress; what is not of this run changes nothing."""
        if progress.run_id != self.run_id or progress.epoch != self.epoch:
            return []
        if progress.who == RECORDER:
            self._saved = max(progress.step, -1 if self._saved is None else self._saved)
        elif progress.who in self._reached:
            known = self._reached[progress.who]
            self._reached[progress.who] = max(progress.step, -1 if known is None else known)
        return [*self._times(), *self._grants()]

    def _times(self) -> list[Time]:
        """Tell the time of every recorded step that the whole flock has reached."""
        every = self._configuration.record_every
        first = self._told + every - self._told % every if self._told >= 0 else 0
        steps = range(first, self.step + 1, every)
        self._told = max(self._told, self.step)
        return [Time.at(self._configuration.stamp(step)) for step in steps]

    def _grants(self) -> list[Grant]:
        if self.step < 0 or (self._record and self._saved is None):
            return []
        limit = min(self.step + self._window, self._configuration.steps)
        if self._record and self._saved is not None:
            limit = min(limit, max(self._saved, 0) + self._ahead)
        if limit <= self._granted:
            return []
        self._granted = limit
        return [self._grant(limit)]

    def _grant(self, step: int) -> Grant:
        configuration = self._configuration
        return Grant(self.run_id, step, configuration.steps, configuration.dt, self.epoch)

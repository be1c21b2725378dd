# SPDX-License-Identifier: Apache-2.0
"""How the clock keeps a flock together, as a state machine: progress in, leave and time out.

The flock may go `window` steps beyond its slowest bird, and never further beyond what is on disk
than the messages on the way to the recorder can hold.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.messages import Grant, Progress, Time
from flock_sim.core.topics import RECORDER, bird_name, steps_ahead

ABSENT = -2
"""The step of somebody who has not been heard of. -1 is a bird that is there and has not heard its
neighbours, or a recorder that is there and has recorded nothing."""


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
        self.step = ABSENT
        """The step that every bird has reached; below 0 before they have heard each other."""
        self.moves = 0
        """How often anybody has moved: a run in which this stays stands still."""
        birds = (bird_name(bird) for bird in range(1, configuration.birds + 1))
        self._reached = dict.fromkeys([*birds, *([RECORDER] if record else [])], ABSENT)
        self._heard: set[str] = set()  # since anybody has moved
        self._record = record
        self._granted = 0
        self._told = -1

    @property
    def first_grant(self) -> Grant:
        """The message that begins the run: everybody to the start."""
        return self._grant(0)

    @property
    def release(self) -> Grant:
        """The message that ends the run, leave beyond its end: nobody needs the birds any more."""
        return self._grant(self._configuration.steps + 1)

    @property
    def finished(self) -> bool:
        """Whether the last step is reached, and on disk where it is to be recorded."""
        end = self._configuration.steps
        last_recorded = end - end % self._configuration.record_every
        return self.step == end and (not self._record or self._saved >= last_recorded)

    @property
    def begun(self) -> bool:
        """Whether all are there, and every bird has heard its neighbours."""
        return self.step >= 0 and ABSENT not in self._reached.values()

    @property
    def where(self) -> str:
        """Where the run is, in words."""
        return f"at step {self.step} of {self._configuration.steps}" if self.begun else "to begin"

    @property
    def waiting_for(self) -> list[str]:
        """Who has to move before the run can go on."""
        absent = [name for name, step in self._reached.items() if step == ABSENT]
        if absent:
            return absent
        if self.step < max(self._granted, 1):
            # Who waits says so again and again; who is silent is what they wait for.
            silent = [name for name, _ in self._birds() if name not in self._heard]
            behind = [name for name, step in self._birds() if step == self.step]
            return silent if silent and self._heard else behind
        return [RECORDER] if self._record else []

    def receive(self, progress: Progress) -> list[Grant | Time]:
        """Take somebody's progress; what is not of this run, or not new, changes nothing."""
        if progress.run_id != self.run_id or progress.epoch != self.epoch:
            return []
        self._heard.add(progress.who)
        if progress.step <= self._reached.get(progress.who, progress.step):
            return []
        self._reached[progress.who] = progress.step
        self.moves += 1
        self._heard.clear()
        self.step = min(step for _, step in self._birds())
        return [*self._times(), *self._grants()]

    @property
    def _saved(self) -> int:
        return self._reached[RECORDER]

    def _birds(self) -> Iterable[tuple[str, int]]:
        return ((name, step) for name, step in self._reached.items() if name != RECORDER)

    def _times(self) -> list[Time]:
        """Tell the time of every recorded step that the whole flock has reached."""
        every = self._configuration.record_every
        steps = range(self._told + 1, self.step + 1)
        self._told = max(self._told, self.step)
        return [Time.at(self._configuration.stamp(step)) for step in steps if step % every == 0]

    def _grants(self) -> list[Grant]:
        if not self.begun:
            return []
        limit = min(self.step + self._window, self._configuration.steps)
        if self._record:
            limit = min(limit, max(self._saved, 0) + self._ahead)
        if limit <= self._granted:
            return []
        self._granted = limit
        return [self._grant(limit)]

    def _grant(self, step: int) -> Grant:
        configuration = self._configuration
        return Grant(self.run_id, step, configuration.steps, configuration.dt, self.epoch)

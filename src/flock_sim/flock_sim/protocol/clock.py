# SPDX-License-Identifier: Apache-2.0
"""How the clock keeps a flock together, as a state machine: progress in, grants and time out.

The flock may go `window` steps beyond its slowest bird. It may go no further beyond the last step
on disk than the recorder's message queues can hold. When a process has restarted, or this clock
itself is a new one, the flock is rewound to the last step on disk: a new epoch begins.
"""

from __future__ import annotations

import secrets
from collections import Counter
from dataclasses import dataclass

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.epochs import ahead, beyond, following, out_of_reach
from flock_sim.messages.handshake import handshake
from flock_sim.messages.rejection import FOREIGN, REPEATED, STALE
from flock_sim.messages.topics import RECORDER, bird_name, steps_ahead
from flock_sim.messages.types import Checkpoint, Grant, Progress, Push, Time
from flock_sim.protocol.attendance import ABSENT, Attendance
from flock_sim.protocol.requests import Window, step_of_push

UNKNOWN = "from a node that is not in this flock"

Message = Grant | Time | Checkpoint | Push


def new_run_id() -> int:
    """Return a unique run id: 1 .. 2**63 - 1, since ROS parameters are signed."""
    return secrets.randbelow(2**63 - 1) + 1


@dataclass
class Rewinds:
    """Cost of recovery so far: the number of rewinds, and of the steps flown again."""

    count: int = 0
    steps: int = 0
    _reached: int = 0  # the step reached before the last rewind

    def rewind(self, reached: int) -> None:
        """Count a rewind. `reached` is the step of the flock, or 0 during another rewind."""
        self.count += 1
        self._reached = max(reached, self._reached)

    def go_on_from(self, step: int) -> None:
        """Count the steps that are flown again, once the flock has begun the epoch at `step`."""
        self.steps += max(0, self._reached - step)
        self._reached = 0


class Timekeeper:
    """The clock of one run. Pass it Progress; send the messages that it returns, in order.

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
        clock_every: int = 0,
    ) -> None:
        """Begin a run of `configuration` under `run_id`; `record`: the run has a recorder.

        `epoch` is the first one. A clock that replaces another one learns of later epochs from the
        other nodes, and goes `beyond` them. `factor` is the real-time factor of a free flight, in
        which the window holds no bird. The time of every `clock_every`th step is published besides
        that of recorded steps; 0: of no other.
        """
        self._configuration = configuration
        every = configuration.record_every
        self._timed = (every, clock_every or every)
        self.free = factor > 0.0
        """Whether birds step by their own timers: the services then refuse."""
        self.lost = False
        """Whether a free flight would need a rewind, which it does not support."""
        self._terms = handshake(configuration, factor)
        self.run_id = run_id
        self.epoch = self._first_epoch = epoch
        self.end = configuration.steps
        """The last step: of the configuration, or the step at which the run was stopped."""
        self.moves = 0
        """Number of moves of all nodes: while it does not change, the run stands still."""
        self.rewinds = Rewinds()
        self.ignored_for: Counter[str] = Counter()
        """How many messages changed nothing, by the reason."""
        birds = map(bird_name, range(1, configuration.birds + 1))
        self._nodes = Attendance(birds, record)
        self._window = Window(
            configuration.steps if factor else window, steps_ahead(configuration, record_stages)
        )
        self.pausing = self._window.pause
        """Where the run pauses on request."""
        self._stopping = False  # stop once all nodes have reported
        self._push: Push | None = None  # the last one that was requested in flight
        self.began: int | None = None
        """The step that the flock was at when all nodes had reported to this clock."""
        self._begin_epoch()

    def _begin_epoch(self) -> None:
        self._nodes.begin_epoch()
        self._window.granted = 0
        self._told = -1  # the last step whose time was published, or that is on disk
        self._checkpoint = ABSENT  # the last step on disk when the epoch began

    @property
    def first_messages(self) -> list[Message]:
        """The messages that begin an epoch: they send every bird to the checkpoint."""
        messages: list[Message] = [self.grant]
        if not self._nodes.recorded:
            messages.append(Checkpoint.of_start(self.run_id, self.epoch))
        return messages

    @property
    def grant(self) -> Grant:
        """The last grant."""
        return self._grant(self._window.granted)

    @property
    def repeated(self) -> list[Message]:
        """What the clock repeats every second: the last grant, and a push that is not on disk yet.

        A recorder that a forged grant has sent to another epoch may have dropped the push.
        """
        lacking = [self._push] if self._push and self.saved == ABSENT else []
        return [*lacking, self.grant]

    @property
    def release(self) -> Grant:
        """The message that ends the run: a grant beyond its end releases the birds.

        Nodes have to hear it twice if the run was `stopped`, as they may have heard of this end in
        no other grant.
        """
        return self._grant(self.end + 1)

    @property
    def stopped(self) -> bool:
        """Whether the run ends earlier than the configuration says."""
        return self.end < self._configuration.steps

    @property
    def finished(self) -> bool:
        """Whether the last step is reached, and is on disk if the run is recorded."""
        if not self._nodes.recorded:
            return self.step >= self.end
        last_recorded = self.end - self.end % self._configuration.record_every
        # If everything is on disk when an epoch begins, birds may have been released already.
        flown = self.step >= self.end or self._checkpoint >= last_recorded
        return flown and self.saved >= last_recorded

    @property
    def begun(self) -> bool:
        """Whether all nodes have reported, and every bird has heard its neighbours."""
        return self._nodes.begun

    @property
    def step(self) -> int:
        """The step that every bird has reached; below 0 until they have heard each other."""
        return self._nodes.step

    @property
    def paused(self) -> bool:
        """Whether the flock has reached the step at which it pauses."""
        return self.pausing.at is not None and self.step >= self.pauses_at

    @property
    def pauses_at(self) -> int:
        """The step that the flock pauses at; the last step if no pause is set."""
        return self.end if self.pausing.at is None else min(self.pausing.at, self.end)

    @property
    def leave_known(self) -> bool:
        """Whether the extent of the grants is known: once all nodes have been present."""
        return self.began is not None

    @property
    def saved(self) -> int:
        """The last step on disk, -1 or less for none; without a recorder, the step reached."""
        return self._nodes.saved

    @property
    def where(self) -> str:
        """The position of the run, as text."""
        return f"at step {self.step} of {self.end}" if self.begun else "before the start"

    @property
    def waiting_for(self) -> list[str]:
        """The nodes that must move before the run can continue; none in a pause."""
        return [] if self.paused else self._nodes.waiting_for(self._window.granted)

    def receive(self, progress: Progress) -> list[Message]:
        """Take a progress report. One of another run, or an old one, has no effect."""
        if progress.run_id != self.run_id:
            return self._ignore(FOREIGN)
        who, incarnation = progress.who, progress.life
        if who not in self._nodes:
            return self._ignore(UNKNOWN)
        later = ahead(progress.epoch, self.epoch)
        came_back = self._nodes.is_new(who, incarnation)
        if out_of_reach(progress.epoch, self.epoch):
            later = 0 if came_back else -1  # the node comes back to our epoch by itself
        ends = self.free and self._window.granted > 0 and (came_back or later > 0)
        if ends and self._nodes.doubts(progress):
            return self._ignore(REPEATED)
        self._nodes.know(who, incarnation)
        if later > 0:
            return self._rewind_to(beyond(progress.epoch, self._first_epoch))
        if came_back:
            return self.rewind()
        if later < 0:
            return self._ignore(STALE)
        if progress.step > self.end:
            return self._ignore(REPEATED)
        first = who == RECORDER and self.saved == ABSENT
        if not self._nodes.reach(who, progress.step):
            return []
        self.moves += 1
        if first:
            self._told = self._checkpoint = progress.step
            self._window.begin(max(0, progress.step))
        if not self.begun:
            return []
        if self._nodes.furthest > self._window.granted:
            return self.rewind()  # granted by another clock, in an epoch of the same number
        self.began = self.step if self.began is None else self.began
        self.rewinds.go_on_from(self.step)
        self.pausing.begin(self._window.granted)
        return [*self._times(), *(self.stop() if self._stopping else self._grants())]

    def rewind(self) -> list[Message]:
        """Rewind all birds to the last step on disk, under a new epoch."""
        return self._rewind_to(following(self.epoch))

    def _rewind_to(self, epoch: int) -> list[Message]:
        self.lost = self.free and self._window.granted > 0
        self.rewinds.rewind(self.step if self.begun else 0)
        self.epoch = epoch
        self.moves += 1
        self._begin_epoch()
        return self.first_messages

    def pause(self) -> None:
        """Pause at the furthest step granted; if none was granted, at the last step on disk."""
        self.pausing.ask(self._window.furthest, self.leave_known)

    def resume(self) -> list[Grant]:
        """Continue after a pause."""
        self.pausing.end()
        return self._grants() if self.begun else []

    def take_steps(self, count: int) -> list[Grant]:
        """Grant `count` more steps, and then pause."""
        self.pausing.take_steps(count, self._window.furthest, self.leave_known)
        return self._grants() if self.begun else []

    def perturb(
        self, bird: int, member: int, step: int, position: float, speed: float
    ) -> tuple[int, list[Message]]:
        """Push a bird at `step`, or at the soonest possible step if `step` is 0.

        `member` 0 means all members. Returns the step, and the messages that begin the epoch with
        the push. Raises FlockError if the push is not possible.
        """
        configuration = self._configuration
        if not self._nodes.recorded:
            raise FlockError(
                "this flight has no recorder, so a push would be lost: fly with a recorder"
            )
        if not (position or speed):
            raise FlockError(
                "position = 0 and speed = 0 change nothing: give one of them another value"
            )
        if not self.begun:
            raise FlockError("the flight is starting or recovering: ask again when birds fly")
        step = step_of_push(step, self._window.granted, self.end)
        # The number of the epoch that it begins distinguishes it from pushes of earlier clocks.
        push = Push(self.run_id, step, position, speed, following(self.epoch), bird, member)
        for one in push.each(configuration.members):
            one.check(configuration.birds, configuration.members, self.end)
        self._push = push
        return step, [push, *self.rewind()]

    def stop(self) -> list[Message]:
        """End the run at the last granted step; during a rewind, where it would continue.

        Nodes take an earlier end at the second grant that names it.
        """
        self.pausing.at = None
        self._stopping = not self.begun
        if self._stopping:
            return []
        self.end = self._window.granted
        return [self.grant, self.grant]

    def _ignore(self, reason: str) -> list[Message]:
        self.ignored_for[reason] += 1
        return []

    def _times(self) -> list[Time]:
        """Return the times of the steps that the whole flock has newly reached."""
        recorded, others = self._timed
        steps = range(self._told + 1, self.step + 1)
        self._told = max(self._told, self.step)
        return [
            Time.at(self._configuration.stamp(step))
            for step in steps
            if step % recorded == 0 or step % others == 0
        ]

    def _grants(self) -> list[Grant]:
        saved = self.saved if self._nodes.recorded else None
        return [self.grant] if self._window.extend(self.step, saved, self.end) else []

    def _grant(self, step: int) -> Grant:
        return Grant(
            self.run_id,
            step,
            self.end,
            self._configuration.dt,
            self.epoch,
            self._terms,
            self._push.number if self._push else 0,
        )

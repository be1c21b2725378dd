# SPDX-License-Identifier: Apache-2.0
"""The recorder of a simulated flight: that of `nodes/recorder.py` without ROS and without a bag."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from flock_sim.messages import topics
from flock_sim.messages.epochs import NEVER, in_order, out_of_date
from flock_sim.messages.topics import RECORDER
from flock_sim.messages.types import Checkpoint, Grant, Memory, Progress, Push, State
from flock_sim.nodes.requested_pushes import RequestedPushes
from flock_sim.protocol.attendance import ABSENT
from flock_sim.protocol.session import Session
from flock_sim.recording.row_assembler import Row, RowAssembler

if TYPE_CHECKING:
    from support.simulator.world import World

RUN = 7
"""The run id of simulated flights."""


class Disk:
    """The recorder's data on disk, which survive its death. RequestedPushes writes into it."""

    closed = False

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.epoch = NEVER  # the last epoch with a grant on disk
        self.live: dict[int, Push] = {}  # the pushes requested in flight, by number

    @property
    def saved(self) -> int:
        return self.rows[-1].step if self.rows else -1

    def write_perturbation(self, push: Push) -> None:
        self.live[push.number] = push

    def later_epoch(self, epoch: int) -> int:
        """Return the last epoch on disk that is later than `epoch`; NEVER without one."""
        known = [*self.live, *([self.epoch] if self.epoch != NEVER else [])]
        later = [one for one in known if out_of_date(epoch, one)]
        return in_order(later)[-1] if later else NEVER


class Recorder:
    """One incarnation of the recorder: a RowAssembler, and a disk that is flushed at times."""

    def __init__(self, world: World, life: int) -> None:
        self.assembler = RowAssembler(world.configuration, world.stages, world.disk.saved)
        self.joined = False
        self.released = False
        self._world = world
        self._session = Session("the recorder", world.configuration, RUN, life)
        self._pushes = RequestedPushes(world.configuration, world.disk, self._session)
        self._wanted = 0  # number of the last push of this epoch
        self._written: list[Row] = []

    @property
    def finished(self) -> bool:
        return self.assembler.complete

    @property
    def waiting_for(self) -> str:
        return f"rows {self.assembler.waiting_for}" if self.joined else f"push {self._wanted}"

    def hear_grant(self, grant: Grant) -> None:
        disk = self._world.disk
        if self._session.refuses_grant(grant):
            return
        later = disk.later_epoch(grant.epoch)
        if self._epoch == NEVER and later != NEVER:
            self._say(disk.saved, later)
            return
        if self._session.take_grant(grant):
            self._flush()
            if not self.assembler.complete:
                disk.epoch = grant.epoch
            self._wanted = grant.perturbation
            self.assembler.begin(RUN, grant.epoch)
            self.joined = self.released = False
        self.released |= grant.step > grant.end
        self.assembler.end_at(grant.end)

    def hear_push(self, data: bytes) -> None:
        self._pushes.hear(data)

    def join(self) -> None:
        """Publish the checkpoint of the epoch once the topics of all birds are found."""
        told = self._wanted == 0 or self._wanted in self._pushes
        if self._epoch == NEVER or self.joined or not told:
            return
        if self.assembler.complete or self._world.all_birds_live:
            self.joined = self._session.flying = True
            self._pushes.write(self._wanted)
            self._world.begin_epoch(self._epoch)
            self._world.publish(RECORDER, topics.CHECKPOINT_TOPIC, self._checkpoint().encode())
            self.report()

    def write(self, rows: Iterable[Row]) -> None:
        self._written += rows

    def keep_safe(self) -> None:
        if self._written:
            self._flush()
            self.report()

    def report(self) -> None:
        if self._epoch != NEVER:
            self._say(self._world.disk.saved if self.joined else ABSENT, self._epoch)

    @property
    def _epoch(self) -> int:
        return self._session.epoch

    def _say(self, step: int, epoch: int) -> None:
        progress = Progress(RUN, step, epoch, RECORDER, self._session.incarnation)
        self._world.publish(RECORDER, topics.PROGRESS_TOPIC, progress.encode())

    def _flush(self) -> None:
        self._world.put_on_disk(self._written)
        self._written = []

    def _checkpoint(self) -> Checkpoint:
        disk = self._world.disk
        pushes = " ".join(map(str, disk.live.values()))
        if not disk.rows:
            return Checkpoint.of_start(RUN, self._epoch, pushes)
        states = [State.decode(data) for data in disk.rows[-1].states]
        memories = [Memory.decode(data).data for data in disk.rows[-1].memories]
        return Checkpoint(
            RUN,
            disk.saved,
            self._epoch,
            np.concatenate([state.position for state in states]),
            np.concatenate([state.speed for state in states]),
            pushes,
            np.concatenate([np.empty(0), *memories]),
            np.concatenate([state.forcing_state for state in states]),
        )

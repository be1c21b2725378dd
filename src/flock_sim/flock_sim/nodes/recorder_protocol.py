# SPDX-License-Identifier: Apache-2.0
"""What a recorder decides, as a state machine: messages and rows in, messages out.

The recorder begins an epoch with the last row on disk, the checkpoint. It takes the rows that
follow, and reports the last one on disk. Endpoints, time and the file belong to its node.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages import types as messages
from flock_sim.messages.epochs import NEVER, in_order, out_of_date
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, MALFORMED, STALE
from flock_sim.nodes.requested_pushes import RequestedPushes
from flock_sim.protocol.attendance import ABSENT
from flock_sim.protocol.session import Session
from flock_sim.recording.flight_writer import Recording
from flock_sim.recording.row_assembler import Row, RowAssembler

Message = messages.Checkpoint | messages.Progress


class RecorderProtocol:
    """The recorder of one run. Pass it messages; publish those that it returns, in order."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        run: Recording,
        run_id: int,
        incarnation: int,
        record_stages: bool = False,
        factor: float = 0.0,
    ) -> None:
        """Record a flock of `configuration` to `run`; `run_id` 0: the run of the first grant.

        `incarnation` distinguishes this process of the recorder from earlier ones. `factor` is the
        real-time factor of a free flight.
        """
        self.assembler = RowAssembler(configuration, record_stages, run.saved, factor > 0.0)
        self.joined = False
        """Whether the checkpoint of this epoch is published: rows are taken from then on."""
        self.unsaved = 0
        """Number of rows that were written and are not on disk yet."""
        self._configuration = configuration
        self._run = run
        self._session = Session("the recorder", configuration, run_id, incarnation, factor)
        self._pushes = RequestedPushes(configuration, run, self._session)
        self._granted = -1  # the furthest granted step of this epoch
        self._push = 0  # number of the push that this epoch begins with

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._session.epoch

    @property
    def ignored_for(self) -> Counter[str]:
        """How many messages changed nothing, by the reason."""
        return self.assembler.ignored_for

    @property
    def finished(self) -> bool:
        """Whether all rows are on disk, and the clock has ended the run."""
        return self.assembler.complete and self._session.over

    @property
    def may_join(self) -> bool:
        """Whether the epoch waits only for the topics of all birds to be discovered."""
        told = self._push == 0 or self._push in self._pushes
        return self.epoch != NEVER and not self.joined and told

    @property
    def waiting_for(self) -> str:
        """What the recorder needs to continue, as text; "the topics of all birds" in `may_join`."""
        if self.epoch == NEVER:
            return "the clock's first grant"
        if not self.joined:
            return "the topics of all birds" if self.may_join else "the clock's perturbation"
        if self.assembler.complete:
            return "the clock's message that the run is over"
        names = [topics.bird_name(bird) for bird in self.assembler.waiting_for]
        return ", ".join(names) or "the clock"

    def receive_grant(self, data: bytes) -> list[Message]:
        """Take a grant. If it begins an epoch, all complete rows go on disk."""
        session = self._session
        try:
            grant = messages.Grant.decode(data)
        except ValueError:
            self.ignored_for[MALFORMED] += 1
            return []
        if reason := session.refuses_grant(grant):
            self.ignored_for[reason] += 1
            return []
        if self.epoch == NEVER and (later := self._later_epoch(grant)) != NEVER:
            # The clock is a new one, and must begin an epoch later than those on disk.
            self.ignored_for[STALE] += 1
            return [self._progress(self._run.saved, grant.run_id, later)]
        new = session.take_grant(grant)
        if new:
            self._begin(grant)
        self.assembler.end_at(session.end)
        if grant.step > self._granted and not self.assembler.complete:
            self._granted = grant.step
            self._run.write_grant(grant.encode())
            if new:
                self._flush()  # a later recorder must know the epoch
        return []

    def receive_push(self, data: bytes) -> None:
        """Keep a push until an epoch begins with it."""
        if reason := self._pushes.hear(data):
            self.ignored_for[reason] += 1

    def receive_wing(self, bird: int, data: bytes) -> list[Row]:
        """Take the wing of a bird, and return the rows that it completes.

        Raises ValueError for a malformed message.
        """
        wing = messages.Wing.decode(data)
        if wing.run_id != self._session.run_id:
            self.ignored_for[FOREIGN] += 1
            return []
        if not np.array_equal(wing.span_ratio, self._configuration.span_ratio[bird - 1]):
            self.ignored_for[IMPOSSIBLE] += 1  # birds of this run agree with the clock
            return []
        return self.assembler.add_wing(bird, data)

    def join(self) -> list[Message]:
        """Begin to take the rows of an epoch that `may_join`, and say where it begins.

        Call this once the topics of all birds have been discovered. Otherwise messages latched by a
        bird would be lost when it ends.
        """
        self.joined = self._session.flying = True
        if self._pushes.write(self._push):
            self._flush()
        return [self._checkpoint(), self._progress(self._run.saved)]

    def write(self, rows: list[Row]) -> None:
        """Write complete rows, which a later `save` puts on disk."""
        for row in rows:
            self._run.write_row(row)
        self.unsaved += len(rows)

    def save(self) -> list[Message]:
        """Put all complete rows on disk, and report it."""
        self._flush()
        return [self._progress(self._run.saved)]

    def report(self) -> list[Message]:
        """Repeat the last report, for a clock that was restarted.

        Before the epoch begins here, the report only says which epoch it is: a clock of an earlier
        one could otherwise not know of it.
        """
        if self.epoch == NEVER:
            return []
        return [self._progress(self._run.saved if self.joined else ABSENT)]

    def _later_epoch(self, grant: messages.Grant) -> int:
        """Return the last epoch on disk that is later than a grant's; NEVER without one.

        Epochs of this run and of pushes count. One out of reach was forged.
        """
        last = self._run.last_grant
        known = [*self._run.live, *([last.epoch] if last and last.run_id == grant.run_id else [])]
        later = [epoch for epoch in known if out_of_date(grant.epoch, epoch)]
        return in_order(later)[-1] if later else NEVER

    def _begin(self, grant: messages.Grant) -> None:
        """Begin an epoch: complete rows go on disk, the birds send the others again."""
        self.joined = False
        self._granted = -1
        self._push = grant.perturbation
        if not self._run.closed:
            self._flush()
        self.assembler.begin(grant.run_id, grant.epoch)

    def _flush(self) -> None:
        self._run.flush()
        self.unsaved = 0

    def _checkpoint(self) -> messages.Checkpoint:
        """Return the checkpoint of this epoch: the last row on disk."""
        states = [messages.State.decode(data) for data in self._run.checkpoint]
        memories = [messages.Memory.decode(data) for data in self._run.memories]
        pushes = " ".join(map(str, self._run.live.values()))
        run_id, epoch = self._session.now
        if not states:
            return messages.Checkpoint.of_start(run_id, epoch, pushes)
        return messages.Checkpoint(
            run_id,
            self._run.saved,
            epoch,
            np.concatenate([state.position for state in states]),
            np.concatenate([state.speed for state in states]),
            pushes,
            np.concatenate([np.empty(0), *(memory.data for memory in memories)]),
            np.concatenate([state.forcing_state for state in states]),
        )

    def _progress(self, step: int, run_id: int = 0, epoch: int = 0) -> messages.Progress:
        """Return a report of the last step on disk, by default in the current run and epoch."""
        session = self._session
        run_id, epoch = run_id or session.run_id, epoch or session.epoch
        return messages.Progress(run_id, step, epoch, topics.RECORDER, session.incarnation)

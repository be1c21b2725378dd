# SPDX-License-Identifier: Apache-2.0
"""The step protocol of one bird, as a state machine: messages in, messages out.

No ROS, no clock, no threads. A bird sends its values at an RK4 stage, waits for the same stage of
its neighbours, computes its slopes and so its values at the next stage. Data dependence alone
keeps neighbours within one stage of each other, so two slots per neighbour hold all that can
arrive; what comes twice, late or too early is counted and changes nothing.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from flock_sim.core import formation
from flock_sim.core.aerodynamics import even_part
from flock_sim.core.bird_step import DRAG, POSITION, SPEED, WORK_ROWS, begin, feel_and_move
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.kernel import FloatArray
from flock_sim.core.messages import Grant, Progress, State, Wing
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.scaling import BirdCoefficients, Scales
from flock_sim.core.stage_message import (
    HEADER,
    HEADER_AT,
    HEADER_END,
    stage_bytes,
    stage_numbers,
    stage_words,
)
from flock_sim.core.topics import bird_name
from flock_sim.errors import FlockError


class Channel(Enum):
    """Where a message of a bird goes."""

    WING = "wing"
    STAGE = "stage"
    STATE = "state"
    PROGRESS = "progress"


Outgoing = tuple[Channel, bytes]


class BirdProtocol:
    """One bird of a flock, flying by its own parameters and its neighbours' messages only.

    Feed it what arrives; send what it returns, in order:

    >>> bird = BirdProtocol(1, FlockConfiguration(birds=1, t_max=2.0, record_every=1))
    >>> out = bird.receive_grant(Grant(run_id=7, step=2, end=2, dt=1.0, epoch=1))
    >>> [channel.value for channel, _ in out if channel is not Channel.STAGE]
    ['wing', 'progress', 'state', 'state', 'progress', 'state', 'progress']
    """

    def __init__(self, bird: int, configuration: FlockConfiguration, run_id: int = 0) -> None:
        """Place bird 1..N at its start. `run_id` 0: that of the first grant heard."""
        self.bird = bird
        self.run_id = run_id
        self.ignored = 0
        self.released = False
        """Whether the clock has said that the run is over, and nobody needs this bird any more."""
        self.neighbours = formation.neighbours(bird, configuration.birds, configuration.coupling)
        self._configuration = configuration
        self._epoch = -1  # of no message: nothing is taken before the first grant
        self._end = configuration.steps
        self._granted = -1
        self._report_at = 0
        self._reached = -1  # the last step whose beginning was reached, its neighbours heard
        self._tick = 0  # 4 step + stage, of the last message sent
        self._held = False  # at the beginning of a step, its own values known, no leave to go on

        members = configuration.members
        self._members = members
        ratio = configuration.span_ratio[bird - 1]
        scales = Scales.of(configuration)
        self._dt = configuration.dt
        self._own = np.vstack(
            [BirdCoefficients.of(scales, ratio).rows(), formation.VORTEX_FRACTION * ratio]
        )
        self._wings = {bird: ratio}
        self._early_wings: list[Wing] = []
        self._geometry = np.empty((len(self.neighbours), 3, members))

        words = stage_words(members)
        count = len(self.neighbours)
        self._heard = np.zeros((2, count, words))
        self._slots = [
            [
                (other, stage_bytes(self._heard[side, k], members))
                for k, other in enumerate(self.neighbours)
            ]
            for side in range(2)
        ]
        # The headers of the messages that this stage still lacks, and the next one, each with the
        # neighbour and the room for it: what has none of these headers is not for us, or not now.
        self._lacking: dict[bytes, tuple[int, memoryview]] = {}
        self._lacking_next: dict[bytes, tuple[int, memoryview]] = {}
        self._mine = np.zeros((2, words))
        self._outbox = [stage_bytes(self._mine[side], members) for side in range(2)]
        self._size = len(self._outbox[0])

        self._work = np.zeros((WORK_ROWS, members))
        self._work[POSITION] = formation.start_position(bird, configuration.birds)
        self._work[SPEED] = scales.cruise_speed
        begin(self._own, self._mine, self._work)

    @property
    def step(self) -> int:
        """The step being taken."""
        return self._tick // STAGES

    @property
    def in_flight(self) -> bool:
        """Whether every wing is known, so that stages are exchanged."""
        return len(self._wings) > len(self.neighbours) and self._granted >= 0

    @property
    def finished(self) -> bool:
        """Whether the last step is reached and its state is out."""
        return self._held and self.step == self._end

    @property
    def missing(self) -> list[int]:
        """The neighbours whose message for this stage is not here yet; none while it is held."""
        return [other for other, _ in self._lacking.values()]

    @property
    def waiting_for(self) -> str:
        """What the bird needs to go on, in words."""
        if self._granted < 0:
            return "the clock's first grant"
        unknown = [bird_name(other) for other in self.neighbours if other not in self._wings]
        if unknown:
            return f"the wing of {', '.join(unknown)}"
        if self.finished:
            return "the clock's word that the run is over"
        if self._held:
            return f"the clock's leave to go beyond step {self.step}"
        stage = f"stage {self._tick % STAGES} of step {self.step}"
        return f"{stage} from {', '.join(map(bird_name, self.missing))}"

    def receive_grant(self, grant: Grant) -> list[Outgoing]:
        """Take leave to go on. The first grant also begins the run."""
        if self._granted < 0 and self.run_id in (0, grant.run_id):
            return self._start(grant)
        if grant.run_id != self.run_id or grant.epoch != self._epoch:
            self.ignored += 1
            return []
        self.released |= grant.step > self._end
        if grant.step <= self._granted:
            return []
        self._grant(grant.step)
        return self._advance() if self._held else []

    def receive_wing(self, wing: Wing) -> list[Outgoing]:
        """Learn the geometry of a neighbour. Raises FlockError if it flies another flock."""
        if self._granted < 0:
            self._early_wings.append(wing)  # a neighbour heard the first grant before us
            return []
        if wing.run_id != self.run_id or wing.bird not in self.neighbours:
            self.ignored += 1
            return []
        if len(wing.span_ratio) != self._members:
            raise FlockError(
                f"{bird_name(wing.bird)} flies {len(wing.span_ratio)} members and "
                f"{bird_name(self.bird)} {self._members}: give both the same span ratios"
            )
        if wing.bird in self._wings:
            return []
        self._wings[wing.bird] = wing.span_ratio
        return self._take_off() if len(self._wings) == 1 + len(self.neighbours) else []

    def receive_stage(self, data: bytes) -> list[Outgoing]:
        """Take the stage message of a neighbour, as it came off the wire."""
        if len(data) == self._size:
            header = data[HEADER_AT:HEADER_END]
            if slot := self._lacking.pop(header, None):
                slot[1][:] = data
                return [] if self._lacking or not self.in_flight else self._advance()
            if slot := self._lacking_next.pop(header, None):
                slot[1][:] = data
                return []
        self.ignored += 1
        return []

    def _start(self, grant: Grant) -> list[Outgoing]:
        configuration = self._configuration
        if grant.dt != configuration.dt or grant.end != configuration.steps:
            raise FlockError(
                f"the clock flies {grant.end} steps of dt = {grant.dt:g} and "
                f"{bird_name(self.bird)} {configuration.steps} of {configuration.dt:g}: "
                "give both the same configuration"
            )
        self.run_id, self._epoch = grant.run_id, grant.epoch
        self._grant(grant.step)
        self._lacking, self._lacking_next = self._expected(0), self._expected(1)
        wing = Wing(self.run_id, self.bird, self._wings[self.bird])
        out = [(Channel.WING, wing.encode()), self._progress(-1)]
        if not self.neighbours:
            out += self._take_off()
        for early in self._early_wings:
            out += self.receive_wing(early)
        return out

    def _grant(self, step: int) -> None:
        step = min(step, self._end)
        self._granted = step
        # Ask for more half way, so that leave comes before it runs out.
        self._report_at = self.step + max(1, (step - self.step) // 2)

    def _take_off(self) -> list[Outgoing]:
        """Work out the geometry, now that every wing is known, and send the first stage."""
        for k, other in enumerate(self.neighbours):
            low, high = sorted((self.bird, other))
            row = np.stack([self._wings[between] for between in range(low, high + 1)])
            self._geometry[k, 0] = formation.lateral_distance(row)
            self._geometry[k, 1] = formation.VORTEX_FRACTION * self._wings[other]
            for m in range(self._members):
                self._geometry[k, 2, m] = even_part(
                    self._geometry[k, 0, m],
                    formation.VORTEX_FRACTION * row[0, m],
                    formation.VORTEX_FRACTION * row[-1, m],
                )
        out = [self._stage()]
        if not self._lacking:
            out += self._advance()
        return out

    def _stage(self) -> Outgoing:
        """Return the message with this tick's values."""
        step, stage = divmod(self._tick, STAGES)
        side = self._outbox[self._tick & 1]
        HEADER.pack_into(
            side, HEADER_AT, self.run_id, step, self._epoch, self.bird, stage, self._members
        )
        return Channel.STAGE, bytes(side)

    def _advance(self) -> list[Outgoing]:
        """Go on, stage by stage, as far as messages and leave allow."""
        out: list[Outgoing] = []
        while not self._lacking:
            step, stage = divmod(self._tick, STAGES)
            if not self._held:
                feel_and_move(
                    self._tick,
                    self._dt,
                    self._own,
                    self._geometry,
                    self._heard,
                    self._mine,
                    self._work,
                )
                if stage == 0:
                    out += self._reports(step, self._mine[self._tick & 1])
            self._held = stage == 0 and step >= self._granted
            if self._held:
                break
            self._tick += 1
            self._lacking, self._lacking_next = self._lacking_next, self._expected(self._tick + 1)
            out.append(self._stage())
        return out

    def _expected(self, tick: int) -> dict[bytes, tuple[int, memoryview]]:
        """Return the headers of all neighbours' messages of `tick`."""
        step, stage = divmod(tick, STAGES)
        run_id, epoch, members, pack = self.run_id, self._epoch, self._members, HEADER.pack
        return {
            pack(run_id, step, epoch, slot[0], stage, members): slot
            for slot in self._slots[tick & 1]
        }

    def _reports(self, step: int, words: FloatArray) -> list[Outgoing]:
        """Return what the recorder and the clock are to know of the beginning of `step`."""
        out = []
        if step % self._configuration.record_every == 0:
            out.append((Channel.STATE, self._state(step, words).encode()))
        self._reached = step
        if step >= self._granted or step == self._report_at:
            out.append(self._progress(step))
        return out

    def report(self) -> list[Outgoing]:
        """Return the word of a bird that has to wait: it is there, and has come so far."""
        if self._granted < 0:
            return []  # there is no run yet to report to
        return [self._progress(self._reached)]

    def _progress(self, step: int) -> Outgoing:
        """Return the report of having reached `step`; -1: here, and not yet at the start."""
        progress = Progress(self.run_id, step, self._epoch, bird_name(self.bird))
        return Channel.PROGRESS, progress.encode()

    def _state(self, step: int, words: FloatArray) -> State:
        position, speed, circulation = stage_numbers(words, self._members)
        return State.at(self._configuration, step, position, speed, circulation, self._work[DRAG])

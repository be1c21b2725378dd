# SPDX-License-Identifier: Apache-2.0
"""Whether a message belongs to the run and the epoch of a node: one rule for all nodes.

A message that this rule refuses has no effect at all. The rule can't detect false values that are
plausible: a node on the same ROS domain that imitates a bird is accepted.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages.epochs import NEVER, out_of_date, out_of_reach
from flock_sim.messages.handshake import check_handshake
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, MALFORMED, REPEATED, STALE
from flock_sim.messages.types import Grant
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.free_flight import NO_WAY_BACK

INCARNATIONS = 2**64
"""Number of values of an incarnation, which has 64 bits in messages."""


class Session:
    """The run and the epoch of one node, and the content of the clock's grants."""

    def __init__(
        self,
        who: str,
        configuration: FlockConfiguration,
        run_id: int,
        incarnation: int = 0,
        factor: float = 0.0,
    ) -> None:
        """Start without an epoch. `run_id` 0: the run of the first grant.

        `incarnation` distinguishes this process of the node from earlier ones. `factor` is the
        real-time factor; 0 in lockstep.
        `who` names the node in errors.
        """
        self.run_id = run_id
        self.epoch = NEVER
        self.incarnation = incarnation
        """A number that the clock has not heard before makes it begin a new epoch."""
        self.flying = False
        """Whether the node flies in this epoch."""
        self.end = configuration.steps
        """The last step of the run: of the configuration, or the step at which it is stopped."""
        self.over = False
        """Whether the clock has ended the run."""
        self._who = who
        self._configuration = configuration
        self._factor = factor
        self._terms = ""
        self._other: tuple[str, float, int] | None = None  # terms, dt, end of another flight
        self._granted = -1
        self._came_late = False  # this epoch's first grant ended the run
        self._silent = False  # no message has arrived since the run was over
        self._doubted = NEVER  # the last epoch out of reach in a grant
        self._named_end = self.end  # of the last grant of this epoch
        self._anew = 0  # grants of later epochs received in a free flight

    @property
    def now(self) -> tuple[int, int]:
        """The current run and epoch."""
        return self.run_id, self.epoch

    def refuses(self, run_id: int, epoch: int) -> str:
        """Return why a message of this run and epoch has no effect, or ""."""
        if run_id == 0 or self.run_id not in (0, run_id):
            return FOREIGN
        if epoch == 0:
            return IMPOSSIBLE
        return STALE if out_of_date(epoch, self.epoch) else ""

    def refuses_grant(self, grant: Grant) -> str:
        """Return why a grant has no effect, or "".

        Raises FlockError if a clock with another configuration repeats its grant before one of this
        flight has arrived: the first one may be forged. Raises RunFailed at the second grant of a
        later epoch during a free flight.
        """
        if reason := self.refuses(grant.run_id, grant.epoch):
            return reason
        first = self.epoch == NEVER
        if first or grant.terms != self._terms:
            try:
                reason = self._differs(grant)
            except FlockError:
                other, self._other = self._other, (grant.terms, grant.dt, grant.end)
                if first and other == self._other:
                    raise
                reason = FOREIGN
            if reason:
                return reason
        if grant.dt != self._configuration.dt:
            return IMPOSSIBLE
        if grant.end > self._configuration.steps or grant.step > grant.end + 1:
            return REPEATED
        if reason := self._refuses_jump(grant.epoch):
            return reason
        same = grant.epoch == self.epoch
        if self._factor and self._granted > 0 and not same:
            self._anew += 1
            if self._anew > 1:
                raise RunFailed(f"{self._who}: {NO_WAY_BACK}")
            return REPEATED
        # A run ends at the last granted step, or later.
        return IMPOSSIBLE if same and grant.end < self._granted else ""

    def take_grant(self, grant: Grant) -> bool:
        """Apply a grant that is not refused; return whether it begins a new epoch.

        If it stops the run before the known end, it does so at the second grant in a row that names
        this end: the first one may be forged.
        """
        self._terms = grant.terms
        new = grant.epoch != self.epoch
        if new:
            if out_of_reach(grant.epoch, self.epoch):
                self.reincarnate()
            self.run_id, self.epoch = grant.run_id, grant.epoch
            self.flying = self.over = self._silent = False
            self._granted = -1
            self.end = grant.end
            self._came_late = grant.step > grant.end
        elif grant.end == self._named_end:
            self.end = min(self.end, grant.end)
        self._named_end = grant.end
        self.over |= grant.step > self.end
        self._granted = max(self._granted, min(grant.step, grant.end))
        return new

    def released(self, step: int) -> bool:
        """Whether the run is over for a node at `step`.

        A node continues to the last recorded step, so that no message can end it early. It ends
        earlier if no more messages arrive, or if it has come back when the run was over.
        """
        last_row = self.end - self.end % self._configuration.record_every
        flown = self.flying and step >= last_row
        return self.over and (flown or self._silent or self._came_late)

    def hear_nothing(self) -> None:
        """Note that no message has arrived for a while."""
        self._silent = self.over

    def reincarnate(self) -> None:
        """Take another incarnation: this node can't continue an epoch that others have begun.

        A node that returns from an epoch out of reach has forgotten the epoch that it had left.
        """
        self.incarnation = (self.incarnation + 1) % INCARNATIONS

    def _refuses_jump(self, epoch: int) -> str:
        """Return why a grant of an epoch out of reach is not taken, or "".

        It is taken at its second grant: the clock repeats a genuine grant within a second.
        """
        if not out_of_reach(epoch, self.epoch):
            return ""
        if self._factor and self._granted > 0:
            return REPEATED  # a free flight joins no other epoch
        doubted, self._doubted = self._doubted, epoch
        again = doubted != NEVER and not out_of_reach(epoch, doubted)
        return "" if again else REPEATED

    def _differs(self, grant: Grant) -> str:
        configuration = self._configuration
        try:
            if grant.terms or self._factor:
                check_handshake(self._who, configuration, grant.terms, self._factor)
                return ""
        except ValueError:
            return MALFORMED
        if grant.dt != configuration.dt or (
            self.epoch == NEVER and grant.end != configuration.steps
        ):
            raise FlockError(
                f"the clock has {grant.end} steps of dt = {grant.dt:g} and {self._who} has "
                f"{configuration.steps} steps of dt = {configuration.dt:g}: "
                "give both the same configuration"
            )
        return ""


class Channel(Enum):
    """Where a message of a bird goes."""

    WING = "wing"
    STAGE = "stage"
    STATE = "state"
    MEMORY = "memory"
    AGES = "ages"
    PROGRESS = "progress"


Outgoing = tuple[Channel, bytes]


MOST_SILENT = 1000
"""Most steps between two reports, however far the grant goes: it may not be the clock's."""


class Granted:
    """How far the clock lets a bird fly in this epoch, and when the bird reports."""

    def __init__(self) -> None:
        """Start without a grant."""
        self.step = -1
        """The step that the bird may begin to fly up to; -1: none."""
        self._report_at = 0

    def extend(self, step: int, at: int) -> None:
        """Take a grant up to `step` at step `at`.

        The bird reports half way, so that the next grant arrives before this one is used up.
        """
        self.step = step
        self._report_at = at + max(1, min((step - at) // 2, MOST_SILENT))

    def reports(self, step: int) -> bool:
        """Whether the bird reports when it begins `step`."""
        due = step >= self.step or step == self._report_at
        if due and self.step - step > MOST_SILENT:
            self._report_at = step + MOST_SILENT
        return due

    def next_event(self, tick: int, every: int, pushes: Iterable[int]) -> int:
        """Return the tick of the next step at which the bird reports, or is held or pushed.

        States are recorded at each `every` steps; `pushes` are the steps of its pushes.
        """
        step = -(-tick // STAGES)
        events = [self.step, -(-step // every) * every, self._report_at]
        ticks = [STAGES * event for event in events if event >= step]
        # A push changes the values that the stage before it computes, before they are sent.
        return min(ticks + [STAGES * event - 1 for event in pushes if event >= step])

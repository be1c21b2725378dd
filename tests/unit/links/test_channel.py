# SPDX-License-Identifier: Apache-2.0
"""The knowledge of a bird over a link, for two birds side by side, message by message."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flock_sim.links.channel import hear
from flock_sim.links.compiled_model import codes
from flock_sim.links.counter_rng import FATE, NOISE, gaussians, uniforms
from flock_sim.links.link_table import MODEL, LinkTable
from flock_sim.physics.runge_kutta import STAGES

SPEED = 1.25
CIRCULATION = 0.5
LATERAL = 3.0
SIGMAS = 5.0
"""Standard errors that a mean may be off by: by chance in one of two million tests."""


class Source:
    """A neighbour that flies at SPEED from 0; `known` tells what the target knows of it."""

    def __init__(self, link: str, dt: float = 1.0, own: float = 0.0) -> None:
        link_table = LinkTable([link], birds=2, coupling="nearest")
        self.members = link_table.members
        self.plan = link_table.plan([2], self.members)
        self.models = codes(self.plan.links[:, MODEL])
        self.memory = self.plan.memory()
        self.dt = dt
        self.next = 0
        """The tick that has not been heard."""
        self.own = np.full(self.members, own)
        self.speed = np.full(self.members, np.nan)
        """The speed that was known at the last tick."""

    def at(self, step: int, stage: int = 0) -> float:
        return SPEED * (step + (0.0, 0.5, 0.5, 1.0)[stage]) * self.dt

    def known(self, step: int, stage: int = 0, circulation: float = CIRCULATION) -> np.ndarray:
        """Position and circulation, shape (2, members), as known at a stage; in order.

        All stages before it of this step have been heard.
        """
        if (STAGES * step + stage) > self.next:
            self.known(*divmod(STAGES * step + stage - 1, STAGES), circulation)
        self.next = STAGES * step + stage + 1
        result = np.empty((2, self.members))
        hear(
            STAGES * step + stage,
            self.dt,
            self.models,
            self.plan.links[0],
            self.plan.faults[0],
            np.full(self.members, LATERAL),
            np.full(self.members, self.at(step, stage)),
            np.full(self.members, SPEED),
            np.full(self.members, circulation),
            self.own,
            self.memory,
            result[0],
            self.speed,
            result[1],
        )
        return result

    def positions(self, steps: int) -> np.ndarray:
        """What is known at stage 0 of all `steps`, shape (steps, members)."""
        return np.array([self.known(step)[0] for step in range(steps)])


def test_exact_knows_what_is_said_at_this_stage():
    source = Source("exact")
    for step in range(3):
        for stage in range(STAGES):
            assert source.known(step, stage)[0] == source.at(step, stage)


@pytest.mark.parametrize("model", ["exact", "exact:delay=1", "hold:interval=2", "linear"])
def test_the_speed_is_that_of_the_last_message(model) -> None:
    source = Source(model)
    for step in range(6):
        known = source.known(step, 2)
        assert source.speed == (SPEED if known[1] else 0.0)
    assert source.speed == SPEED


def test_exact_that_is_late_knows_the_same_stage_of_an_earlier_step():
    source = Source("exact:delay=2")
    for step in range(5):
        for stage in range(STAGES):
            position, circulation = source.known(step, stage)
            assert position == (source.at(step - 2, stage) if step >= 2 else 0.0)
            assert circulation == (CIRCULATION if step >= 2 else 0.0)


def test_hold_knows_the_last_exchange_at_all_stages():
    source = Source("hold:interval=3")
    for step in range(8):
        for stage in range(STAGES):
            assert source.known(step, stage)[0] == source.at(3 * (step // 3))


def test_linear_moves_the_circulation_on_as_it_has_changed():
    source = Source("linear:interval=4,delay=1", dt=0.5)
    known = [source.known(step, stage=1, circulation=0.5 + 0.01 * step)[1] for step in range(9)]
    # The messages of steps 0 and 4 say 0.5 and 0.54, and are used from steps 1 and 5 on. From the
    # first alone no change is known; from both it is 0.02 in b/U_min, that is 0.01 a step; stage 1
    # is half a step on. Rounding: some sums and products of numbers below 1.
    expected = [0.0, 0.5, 0.5, 0.5, 0.5, *(0.5 + 0.01 * (step + 0.5) for step in range(5, 9))]
    assert np.concatenate(known) == pytest.approx(expected, abs=1e-15)


def test_linear_keeps_a_circulation_that_noise_would_change_more():
    source = Source("linear:interval=4,speed_quantum=0.25")
    known = [source.known(step, circulation=0.5 + 0.01 * step)[1][0] for step in range(8)]
    assert known == [0.5] * 4 + [0.54] * 4


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_linear_knows_exactly_who_flies_straight_on(dt):
    source = Source("linear:interval=3,delay=2", dt)
    for step in range(12):
        for stage in range(STAGES):
            position = source.known(step, stage)[0]
            if step >= 2:
                # Exact but for the rounding of a product and a sum.
                assert position == pytest.approx(source.at(step, stage), rel=4e-16)


def test_a_held_neighbour_is_seen_its_speed_times_the_lag_behind():
    for delay in (0, 1, 5):
        source = Source(f"hold:delay={delay}")
        for step in range(20):
            position = source.known(step)[0]
            if step >= delay:
                assert source.at(step) - position == SPEED * delay


def test_nothing_is_known_before_the_first_message_has_arrived():
    source = Source("linear:delay=3")
    assert [source.known(step)[1][0] for step in range(5)] == [0, 0, 0, CIRCULATION, CIRCULATION]


def test_of_what_has_arrived_the_last_sent_is_known():
    source = Source("hold:jitter=4,seed=3")
    # By definition: the message of step m can be used from m + floor(5 u) on.
    usable = [m + math.floor(5.0 * uniforms(3, 1, 2, m, FATE)[1]) for m in range(200)]
    overtaken = 0
    for step in range(200):
        arrived = [m for m in range(step + 1) if usable[m] <= step]
        position, circulation = source.known(step)
        assert position == (source.at(max(arrived)) if arrived else 0.0)
        assert circulation == (CIRCULATION if arrived else 0.0)
        overtaken += any(usable[m] > usable[m + 1] for m in range(max(step - 1, 0)))
    assert overtaken


def test_jitter_is_even_from_none_to_its_most():
    steps, most = 4000, 3
    late = [math.floor((most + 1) * uniforms(0, 1, 2, m, FATE)[1]) for m in range(steps)]
    counts = np.bincount(late, minlength=most + 1)
    assert len(counts) == most + 1
    # Each count is binomial with p = 1/4.
    assert np.all(abs(counts - steps / 4) < SIGMAS * math.sqrt(steps * 0.25 * 0.75))


@pytest.mark.parametrize("model", ["exact", "hold"])
def test_drop_is_the_share_of_exchanges_that_never_arrive(model):
    steps, drop = 4000, 0.3
    source = Source(f"{model}:drop={drop}")
    lost = 0
    for step in range(1, steps + 1):
        heard = [
            bool(source.known(step, stage)[0] == source.at(step, stage)) for stage in range(STAGES)
        ]
        lost += not heard[0]
        if model == "exact":
            assert len(set(heard)) == 1, "all stages of a step are lost together"
    assert abs(lost / steps - drop) < SIGMAS * math.sqrt(drop * (1.0 - drop) / steps)


def test_noise_has_the_standard_deviations_that_are_asked_for():
    steps, deviation = 4000, 0.02
    source = Source(f"hold:position_noise={deviation},speed_noise=0.01,seed=5")
    errors, ratios = [], []
    for step in range(steps):
        position, circulation = source.known(step)
        errors.append(position[0] - source.at(step))
        ratios.append(CIRCULATION / circulation[0])  # speed as known over that sent
    # The error of a mean is s/sqrt(n), that of a standard deviation s/sqrt(2n).
    for sample, mean, spread in ((errors, 0.0, deviation), (ratios, 1.0, 0.01 / SPEED)):
        assert abs(np.mean(sample) - mean) < SIGMAS * spread / math.sqrt(steps)
        assert abs(np.std(sample) - spread) < SIGMAS * spread / math.sqrt(2 * steps)


def test_noise_is_drawn_for_every_message_once():
    source = Source("exact:position_noise=0.1,seed=9")
    noise = [source.known(4, stage)[0][0] - source.at(4, stage) for stage in range(STAGES)]
    drawn = [0.1 * gaussians(9, 1, 2, 4, NOISE + stage)[0] for stage in range(STAGES)]
    # Positions are below 8: their sum with the noise is rounded by half of 2^-50 at most.
    assert noise == pytest.approx(drawn, rel=0.0, abs=2.0**-50)
    held = Source("hold:interval=5,position_noise=0.1")
    assert len({held.known(step, stage)[0][0] for step in range(5) for stage in range(4)}) == 1


def test_quantum_rounds_position_and_speed_and_circulation_follows_the_speed():
    position, circulation = Source("hold:position_quantum=0.5,speed_quantum=0.5").known(1)
    assert position == 1.0  # 1.25 is as near to 1.5: to the even multiple
    assert circulation == CIRCULATION * SPEED / 1.0
    position, circulation = Source("hold:quantum=0.5").known(1)
    assert (position, circulation) == (1.0, CIRCULATION * SPEED / 1.0)


def test_circulation_is_as_sent_where_the_speed_is():
    assert Source("hold:position_noise=0.1,position_quantum=0.3").known(1)[1] == CIRCULATION


def test_nothing_is_received_beyond_the_range():
    # 4 ahead and 3 aside are 5 away. At step 4 the source is at 5, and 1, 0 ... from the target.
    for reach, heard in ((5.0, True), (4.99, False)):
        source = Source(f"hold:range={reach}", own=4.0 + SPEED)
        assert bool(source.known(1)[1] == CIRCULATION) is heard


def test_range_is_measured_when_the_message_is_sent():
    source = Source("hold:delay=2,range=5", own=0.0)
    # |x| = 0, 1.25, 2.5, 3.75 are within 4; 5 and more are not. So step 3 is the last heard of.
    assert [source.known(step)[0][0] / SPEED for step in range(8)] == [0, 0, 0, 1, 2, 3, 3, 3]


def test_what_is_older_than_the_timeout_is_not_known():
    source = Source("linear:interval=4,timeout=2")
    heard = [source.known(step)[1][0] > 0.0 for step in range(8)]
    assert heard == [True, True, True, False] * 2


@pytest.mark.parametrize(
    "alone",
    [
        "hold:interval=2,delay=3",
        "hold:interval=2,jitter=4",
        "hold:interval=2,drop=0.5",
        "hold:interval=2,position_noise=0.3,speed_noise=0.1",
        "hold:interval=2,seed=8,drop=0.5",
        "hold:interval=2,range=3.5,timeout=3,quantum=0.1",
    ],
)
def test_members_are_as_if_they_were_alone(alone):
    faults = [item for item in alone.partition(":")[2].split(",") if "interval" not in item]
    defaults = {"seed": "0", "range": "inf", "timeout": "inf"}
    both = [f"{item}/{defaults.get(item.partition('=')[0], '0')}" for item in faults]
    with_fault, without = Source(alone), Source("hold:interval=2")
    if "seed" in alone:
        both = [item.replace("drop=0.5/0", "drop=0.5") for item in both]
        without = Source("hold:interval=2,drop=0.5")
    together = Source(f"hold:interval=2,{','.join(both)}").positions(40)
    assert np.array_equal(together[:, :1], with_fault.positions(40))
    assert np.array_equal(together[:, 1:], without.positions(40))


def test_members_with_one_seed_have_the_same_luck():
    positions = Source("hold:drop=0.5,jitter=3,noise=0.1,seed=4/4/5").positions(40)
    assert np.array_equal(positions[:, 0], positions[:, 1])
    assert not np.array_equal(positions[:, 0], positions[:, 2])


def test_a_link_is_remembered_for_the_longest_delay_and_no_longer():
    # The latest and floor(11 / 4) + 1 = 3 on their way; five numbers each, at one stage or four.
    assert Source("hold:interval=4,delay=3/7,jitter=4").memory.shape == (4 * 5, 2)
    assert Source("exact:delay=2").memory.shape == ((1 + 3) * 4 * 5, 1)
    assert Source("exact").memory.shape == (0, 1)


@pytest.mark.parametrize("link", ["linear", "linear:speed_noise=0.1,position_noise=0.1"])
def test_a_neighbour_that_diverged_leaves_the_same_nan_on_every_machine(link):
    # The sign of the NaN of inf - inf depends on the processor, and the memory is recorded.
    source = Source(link)
    for step, circulation in enumerate((np.inf, np.inf, math.copysign(math.nan, -1.0))):
        source.known(step, circulation=circulation)
        assert not np.signbit(source.memory).any()
    assert np.isnan(source.memory).any()

# SPDX-License-Identifier: Apache-2.0
"""The frequencies resolve every resonance, and count the roots that grow."""

from dataclasses import replace

import numpy as np
import pytest

from flock_sim.errors import RunFailed
from flock_sim.response import frequencies
from flock_sim.response.chain import Chain
from flock_sim.response.dense import Dense
from flock_sim.response.frequencies import Frequencies
from support.linear_flocks import mixed_flock, motion_of, responses, state_space
from support.steady_states import flock_of


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [2, 3, 8, 13, 51])
def test_a_frequency_lies_within_the_width_of_every_resonance(birds, coupling):
    # Equal birds have pairs of resonances that almost coincide.
    flock = flock_of(birds, coupling=coupling)
    found = Frequencies.of(responses(flock))
    assert (found.unstable, found.unstable_led) == (0, 0)
    for root in np.linalg.eigvals(state_space(flock)[0]):
        assert np.abs(found.omega - abs(root.imag)).min() < 0.7 * abs(root.real)


@pytest.mark.parametrize("kind", [Chain, Dense])
@pytest.mark.parametrize("shift", [0.0, 3e-4, 6.5e-4, 7e-4, 7.2e-4, 2e-3])
def test_growing_roots_are_counted(shift, kind):
    # Less damping of all birds moves all roots to the right, one pair after the other.
    motion = motion_of(mixed_flock(7))
    motion = replace(motion, damping=motion.damping - 2.0 * shift)
    roots = np.linalg.eigvals(motion.generator(0))
    found = Frequencies.of(kind(motion))
    assert found.unstable == (roots.real > 0.0).sum()
    led = [0, 1, 2, 4, 5, 6]
    inner = replace(
        motion,
        damping=motion.damping[led],
        pull=motion.pull[np.ix_(led, led)],
        push=motion.push[np.ix_(led, led)],
        surge=motion.surge[np.ix_(led, led)],
    )
    stiffness = inner.pull - np.diag(motion.pull.sum(axis=1)[led])
    matrix = np.block(
        [[np.zeros((6, 6)), np.eye(6)], [stiffness, inner.push - np.diag(inner.damping)]]
    )
    assert found.unstable_led == (np.linalg.eigvals(matrix).real > 0.0).sum()


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("lag", [20.0, 41.0, 43.0, 60.0])
def test_growing_roots_with_a_lag_are_counted(lag, coupling):
    # Three geese that extrapolate lose stability at a lag of 41.8 (nearest-neighbour coupling).
    flock = flock_of(3, coupling=coupling)
    expected = (motion_of(flock, lag, "linear").rightmost_roots(5).real > 0.0).sum()
    assert Frequencies.of(responses(flock, lag, "linear")).unstable == expected
    if coupling == "nearest":
        assert (expected > 0) == (lag > 42.0)


def test_birds_that_a_leader_far_behind_hardly_holds():
    # Bird 6 is the front of these late birds, and bird 16 leads: from bird to bird ahead of it,
    # springs are 0.003 times as strong, and the slowest root of the led birds is 1e-22.
    flock = mixed_flock(31, spread=1e-3)
    chain = responses(flock, 20.0, "hold")
    slopes = chain.logarithms(np.zeros(1))[1]
    assert np.abs(slopes).max() > 1e22
    found = Frequencies.of(chain)
    assert (found.unstable, found.unstable_led) == (0, 0)
    assert len(found.omega) < 1000


def test_resonances_without_end_are_refused(monkeypatch):
    monkeypatch.setattr(frequencies, "MOST_FREQUENCIES", 100)
    with pytest.raises(RunFailed, match=r"resonances narrower than .* hardly damps"):
        Frequencies.of(responses(flock_of(13)))

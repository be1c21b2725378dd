# SPDX-License-Identifier: Apache-2.0
"""Variances in gusts: against Lyapunov's equation, and against the equations in time."""

import numpy as np
import pytest

from flock_sim.errors import RunFailed
from flock_sim.response.frequencies import Frequencies
from flock_sim.response.gust import variances_by_covariance, variances_by_frequency
from support.linear_flocks import mixed_flock, motion_of, responses, state_space
from support.steady_states import flock_of


def by_frequency(flock, lag=0.0, model="linear"):
    curves = responses(flock, lag, model)
    return variances_by_frequency(curves.densities, Frequencies.of(curves).omega)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 3, 6])
def test_the_covariance_solves_lyapunovs_equation(birds, coupling):
    # A X + X A^T = -B B^T as one linear system, in which gaps are scaled to the size of speeds.
    flock = mixed_flock(birds, coupling)
    matrix, force = state_space(flock)
    scale = np.where(np.arange(len(matrix)) < birds - 1, 0.02, 1.0)
    matrix = scale[:, np.newaxis] * matrix / scale
    one = np.eye(len(matrix))
    system = np.kron(matrix, one) + np.kron(one, matrix)
    covariance = np.linalg.solve(system, -(force @ force.T).ravel()).reshape(matrix.shape)
    speeds = covariance[birds - 1 :, birds - 1 :]
    expected = np.append(np.diag(covariance) / scale**2, speeds.mean())
    found = variances_by_covariance(motion_of(flock))
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 3, 12, 31])
def test_the_integral_over_frequency_is_the_covariance(birds, coupling):
    flock = mixed_flock(birds, coupling, spread=0.001)
    expected = variances_by_covariance(motion_of(flock))
    np.testing.assert_allclose(by_frequency(flock), expected, rtol=1e-11)


def by_time(motion, steps_of_lag, end):
    """The same variances by squared responses to impulses, which Runge-Kutta steps compute.

    Values are known at multiples of half a step, which are `steps_of_lag` to a lag. At a multiple
    of the lag, the impulse arrives by way of accelerations seen: speeds jump by powers of surge.
    """
    birds = len(motion.damping)
    half = motion.lag / steps_of_lag
    total, damping = motion.pull.sum(axis=1)[:, np.newaxis], motion.damping[:, np.newaxis]
    nothing = np.zeros((birds, birds))
    position, speed = [nothing], {(0, 0): nothing, (0, 1): np.eye(birds)}
    rate = {(0, 0): nothing}

    def slope(k, side, x, v):
        """dv/dt just before (side 0) or after (side 1) half step k."""
        past = k - steps_of_lag, side
        if past[0] < 0:
            return -total * x - damping * v
        seen = motion.pull @ position[past[0]] + motion.push @ speed[past]
        return seen + motion.surge @ rate[past] - total * x - damping * v

    rate[0, 1] = slope(0, 1, nothing, np.eye(birds))
    jump = np.eye(birds)
    sums = np.zeros(2 * birds)

    def squares(x, v):
        parts = [np.diff(x, axis=0), v, v.mean(axis=0, keepdims=True)]
        return np.concatenate([(part**2).sum(axis=1) for part in parts])

    for k in range(0, round(end / half), 2):
        x, v, a1 = position[k], speed[k, 1], rate[k, 1]
        a2 = slope(k + 1, 1, x + half * v, v + half * a1)
        a3 = slope(k + 1, 1, x + half * (v + half * a1), v + half * a2)
        a4 = slope(k + 2, 0, x + 2.0 * half * (v + half * a2), v + 2.0 * half * a3)
        last_x = x + 2.0 * half * (v + half / 3.0 * (a1 + a2 + a3))
        last_v = v + half / 3.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        last_a = slope(k + 2, 0, last_x, last_v)
        # the middle by the cubic through both ends
        middle_x = 0.5 * (x + last_x) + 0.25 * half * (v - last_v)
        middle_v = 0.5 * (v + last_v) + 0.25 * half * (a1 - last_a)
        sums += squares(x, v) + 4.0 * squares(middle_x, middle_v) + squares(last_x, last_v)
        position += [middle_x, last_x]
        speed[k + 1, 0] = speed[k + 1, 1] = middle_v
        speed[k + 2, 0] = speed[k + 2, 1] = last_v
        if (k + 2) % steps_of_lag == 0:
            jump = motion.surge @ jump
            speed[k + 2, 1] = last_v + jump
        rate[k + 1, 0] = rate[k + 1, 1] = slope(k + 1, 1, middle_x, middle_v)
        rate[k + 2, 0] = last_a
        rate[k + 2, 1] = slope(k + 2, 1, last_x, speed[k + 2, 1])
    return half / 3.0 * sums


@pytest.mark.parametrize("model", ["linear", "hold"])
@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_with_a_lag_impulse_responses_give_the_same(coupling, model):
    # The slowest mode decays as exp(-3e-5 t) or faster with `hold`, and less of it than 1e-7 is
    # left at the end. Steps of 4 are short against periods of 280.
    flock = mixed_flock(3, coupling)
    motion = motion_of(flock, 20.0, model)
    slowest = -motion.rightmost_roots()[0].real
    expected = by_time(motion, 10, 8.0 / slowest)
    np.testing.assert_allclose(by_frequency(flock, 20.0, model), expected, rtol=1e-6)


def test_integrals_that_do_not_converge_are_refused():
    def densities(omega):
        return 1.0 / np.abs(omega - 0.3)[:, np.newaxis]

    with pytest.raises(RunFailed, match="do not converge"):
        variances_by_frequency(densities, np.array([0.0, 0.5, 1.0]))


def test_a_bird_alone_by_hand():
    flock = flock_of(1)
    damping = motion_of(flock).damping[0]
    assert by_frequency(flock) == pytest.approx([0.5 / damping] * 2, rel=1e-12)

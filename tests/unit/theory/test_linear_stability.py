# SPDX-License-Identifier: Apache-2.0
"""The Jacobian against differences to 50 digits; its eigenvalues against flights and by hand."""

from math import sqrt

import mpmath
import numpy as np
import pytest
from mpmath import mp
from scipy.linalg import expm

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock import Flock
from flock_sim.reference.integrator import Reference
from flock_sim.theory import linear_stability
from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.linear_stability import eigenvalues, jacobian
from support.steady_flocks import (
    MASS,
    STRENGTH,
    A,
    K,
    forces,
    integral,
    pair_of,
    positions_of,
    random_ratios,
)
from support.steady_states import flock_of, rate_and_frequency


def steady_jacobian(flock, state, member):
    """The Jacobian at the steady state of one member, all positions from the first bird."""
    alone = Flock(flock.coupling, flock.scales, flock.span_ratio[:, [member]])
    position = positions_of(state.spacing[:, member])[:, np.newaxis]
    return jacobian(alone, position, np.full_like(position, state.speed[member]))[0]


def assert_same_numbers(found, expected, tolerance):
    """Whether two sets of complex numbers are the same, each matched with the nearest."""
    left = list(expected)
    assert len(found) == len(left)
    for value in found:
        nearest = min(range(len(left)), key=lambda k: abs(left[k] - value))
        assert abs(left.pop(nearest) - value) < tolerance


# --- the Jacobian ---


def accelerations(positions, speeds, ratios, coupling):
    """dU/dt of every bird, from the paper's formulas in mpmath."""
    force = forces(positions, speeds, ratios, coupling, of=mp)
    return [K * value / (MASS * ratio**3) for value, ratio in zip(force, ratios)]


def differences(positions, speeds, ratios, coupling):
    """The lower half of the Jacobian by central differences of 1e-16 in 50 digits: to 1e-32."""
    birds = len(ratios)
    matrix = np.empty((birds, 2 * birds))
    with mpmath.workdps(50):
        state = [mp.mpf(value) for value in (*positions, *speeds)]
        ratios = [mp.mpf(ratio) for ratio in ratios]
        step = mp.mpf(10) ** -16
        for column in range(2 * birds):
            sides = []
            for sign in (1, -1):
                moved = list(state)
                moved[column] += sign * step
                sides.append(accelerations(moved[:birds], moved[birds:], ratios, coupling))
            for row in range(birds):
                matrix[row, column] = (sides[0][row] - sides[1][row]) / (2 * step)
    return matrix


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 4])
def test_jacobian_is_the_derivative_of_the_equations_of_motion(birds, coupling):
    # At any state: gaps of both signs, speeds that differ. Every entry is a sum of up to 2 N terms
    # below 0.01, each known to some ten roundings.
    random = np.random.default_rng(birds)
    ratios = random.uniform(0.8, 1.3, (birds, 4))
    position = 2.0 * random.standard_normal((birds, 4))
    position[:, 0] = 0.0  # side by side, where I is smooth and its formula is not
    position[:, 1] *= 50.0
    speed = random.uniform(0.9, 1.4, (birds, 4))
    found = jacobian(flock_of(birds, ratios, coupling=coupling), position, speed)
    assert found.shape == (4, 2 * birds, 2 * birds)
    for member in range(4):
        columns = (values[:, member].tolist() for values in (position, speed, ratios))
        expected = differences(*columns, coupling)
        np.testing.assert_allclose(found[member, birds:], expected, rtol=1e-11, atol=1e-16)
        kinematics = np.hstack([np.zeros((birds, birds)), np.eye(birds)])
        np.testing.assert_array_equal(found[member, :birds], kinematics)


def test_moving_the_whole_flock_changes_nothing():
    ratios = random_ratios(seed=2, birds=6, members=3, spread=0.02)
    position = np.random.default_rng(1).standard_normal((6, 3))
    matrix = jacobian(flock_of(6, ratios, coupling="all"), position, np.full((6, 3), 1.2))
    shift = np.concatenate([np.ones(6), np.zeros(6)])
    # Five stiffnesses of 1e-3 are added up and taken away again.
    np.testing.assert_allclose(matrix @ shift, 0.0, atol=1e-17)


# --- eigenvalues ---


@pytest.mark.parametrize(("coupling", "birds"), [("nearest", 5), ("nearest", 13), ("all", 5)])
def test_only_the_translation_is_left_out(coupling, birds):
    # LAPACK's eigenvalues are those of a matrix 1e-16 away, |J| = 1, and move by as much times
    # their condition, 1e4 at most here. (0 and a slow mode are what makes them ill-conditioned.)
    ratios = random_ratios(seed=birds, birds=birds, members=20, spread=0.005)
    flock = flock_of(birds, ratios, coupling=coupling)
    state = equilibrium(flock)
    assert state.exists.sum() > 10
    found = eigenvalues(flock, state.spacing, state.speed)
    assert found.shape == (20, 2 * birds - 1)
    for member in np.flatnonzero(state.exists):
        everything = np.linalg.eigvals(steady_jacobian(flock, state, member))
        assert_same_numbers([0.0, *found[member]], everything, 1e-11)


def test_a_bird_alone_relaxes_to_its_speed():
    flock = flock_of(1, np.array([[1.0, 1.2]]))
    state = equilibrium(flock)
    for member, ratio in enumerate((1.0, 1.2)):
        speed = state.speed[member]
        damping = 2.0 * K * (ratio**2 * speed - ratio**4 / speed**3)
        found = eigenvalues(flock, state.spacing, state.speed)[member]
        assert found == pytest.approx([-damping / (ratio**3 * MASS)], rel=1e-13)


def constants(x, speed):
    """P = dD_21/dx < 0, Q = dD/dU of solo flight, C = D_12 + D_21 of two standard birds."""
    with mpmath.workdps(30):
        slope = mp.diff(lambda x: integral(x, 1.0 + A, mp.mpf(A), mp.mpf(A), mp), x)
    stiffness = 0.5 * K * STRENGTH / speed**2 * float(slope)
    return stiffness, 2.0 * K * (speed - speed**-3), K * pair_of(1.0, 1.0, speed)


def oscillator(mass, damping, stiffness):
    """Both mu of m mu^2 + damping mu - stiffness = 0."""
    root = np.emath.sqrt(damping**2 + 4.0 * mass * stiffness)
    return [(-damping + root) / (2.0 * mass), (-damping - root) / (2.0 * mass)]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_two_birds_by_hand(coupling):
    # Side by side D_12 = D_21 = C / 2. Their gap: m mu^2 = -Q mu + 2 P, as the Gammas' share is the
    # same for both. Their common speed: m mu = -Q + C / U, both drags going as 1 / (U_1 U_2).
    flock = flock_of(2, coupling=coupling)
    state = equilibrium(flock)
    speed = float(state.speed[0])
    p, q, c = constants(0.0, speed)
    expected = [*oscillator(MASS, q, 2.0 * p), (-q + c / speed) / MASS]
    assert_same_numbers(eigenvalues(flock, state.spacing, state.speed)[0], expected, 1e-14)


def three_birds():
    """The flock of three, its state, x = x_2 - x_1, U* and P, Q, C."""
    flock = flock_of(3)
    state = equilibrium(flock)
    x, speed = float(state.spacing[0, 0]), float(state.speed[0])
    return flock, state, speed, constants(x, speed)


def test_three_birds_by_hand():
    # Bird 1 feels D_21 = 2 C / 3, the leader twice D_12 = C / 3: as much. With d and v the changes
    # of position and speed,
    #   m v_1' = -Q v_1 - P (d_2 - d_1) + D_21 (v_1 + v_2) / U, and alike bird 3,
    #   m v_2' = -Q v_2 + P (2 d_2 - d_1 - d_3) + D_12 (v_1 + 2 v_2 + v_3) / U.
    # Leader against both: m w' = -Q w + 3 P d, what drags owe to speeds being the same for all.
    # All at one speed: m v' = (-Q + 2 D_21 / U) v. Bird 1 against bird 3, the leader at rest:
    #   m v' = -Q v + P d + D_21 v / U.
    flock, state, speed, (p, q, c) = three_birds()
    assert p < 0.0 < q
    assert c < 0.0
    damping = q - 2.0 * c / (3.0 * speed)
    expected = [
        *oscillator(MASS, q, 3.0 * p),
        (-q + 4.0 * c / (3.0 * speed)) / MASS,
        *oscillator(MASS, damping, p),
    ]
    found = eigenvalues(flock, state.spacing, state.speed)[0]
    # Entries of J below 1 and their roundings; the five are 1e-3 or more apart.
    assert_same_numbers(found, expected, 1e-14)


def test_the_printed_eigenvalues_are_not_those_of_the_equations():
    # sqrt(Q^2 - 12 m P) with P < 0 would be real, above Q, and one of its two would grow.
    flock, state, _, (p, q, _) = three_birds()
    printed = (-q + sqrt(q**2 - 12.0 * MASS * p)) / (2.0 * MASS)
    assert printed > 0.01
    found = eigenvalues(flock, state.spacing, state.speed)[0]
    assert found.real.max() < 0.0
    for sign in (1.0, -1.0):
        value = (-q + sign * sqrt(q**2 - 12.0 * MASS * p)) / (2.0 * MASS)
        assert np.abs(found - value).min() > 0.01


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 3, 4, 7, 13, 31])
def test_formations_of_equals_are_stable(birds, coupling):
    flock = flock_of(birds, coupling=coupling)
    state = equilibrium(flock)
    found = eigenvalues(flock, state.spacing, state.speed)[0]
    assert np.all(found.real < 0.0)
    # They come in conjugate pairs.
    assert_same_numbers(found, found.conj(), 1e-12)


def test_the_slowest_to_fade_comes_first():
    ratios = random_ratios(seed=4, birds=5, members=30, spread=0.02)
    flock = flock_of(5, ratios)
    state = equilibrium(flock)
    found = eigenvalues(flock, state.spacing, state.speed)
    assert np.all(np.diff(found[state.exists].real, axis=1) <= 0.0)


def test_where_there_is_no_state_there_are_no_eigenvalues():
    ratios = np.ones((5, 3))
    ratios[1, 1] = 0.6
    flock = flock_of(5, ratios)
    state = equilibrium(flock)
    assert state.exists.tolist() == [True, False, True]
    found = eigenvalues(flock, state.spacing, state.speed)
    assert np.isnan(found[1].real).all()
    assert np.isnan(found[1].imag).all()
    np.testing.assert_array_equal(found[0], found[2])
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_members_are_independent_however_many_are_held_at_once(coupling, monkeypatch):
    ratios = random_ratios(seed=4, birds=5, members=20, spread=0.02)
    flock = flock_of(5, ratios, coupling=coupling)
    state = equilibrium(flock)
    together = eigenvalues(flock, state.spacing, state.speed)
    monkeypatch.setattr(linear_stability, "BLOCK", 3)
    in_threes = eigenvalues(flock, state.spacing, state.speed)
    assert together.tobytes() == in_threes.tobytes()
    for member in (0, 7, 19):
        alone = eigenvalues(
            flock_of(5, ratios[:, [member]], coupling=coupling),
            state.spacing[:, [member]],
            state.speed[[member]],
        )
        assert alone.tobytes() == together[[member]].tobytes()


# --- what is seen in flight ---


def disturbed(ratios, push, coupling="nearest", *, dt, t_max, every):
    """How a small disturbance `push` of (x, U) of a steady flock goes on, shape (records, 2 N).

    Half the difference of two flights, disturbed by 1e-4 of it either way, over 1e-4: what is of
    second order drops out, and what is of third order is 1e-8.
    """
    small, birds = 1e-4, len(ratios)
    configuration = FlockConfiguration(
        birds=birds, coupling=coupling, dt=dt, t_max=t_max, record_every=every
    )
    pair = np.repeat(ratios, 2, axis=1)
    state = equilibrium(Flock.of(configuration, pair))
    flight = Reference(configuration, pair)
    ways = small * np.array([1.0, -1.0])
    flight.position[:] = positions_of(state.spacing[:, 0])[:, np.newaxis]
    flight.position += push[:birds, np.newaxis] * ways
    flight.speed[:] = state.speed[0] + push[birds:, np.newaxis] * ways
    seen = flight.advance(configuration.steps)[:, :2]  # (records, 2, birds, members)
    return ((seen[..., 0] - seen[..., 1]) / (2.0 * small)).reshape(len(seen), -1)


@pytest.mark.parametrize(("coupling", "birds"), [("nearest", 5), ("nearest", 4), ("all", 4)])
def test_small_disturbances_go_on_as_the_jacobian_says(coupling, birds):
    # x of 300 is rounded to 6e-14, a 1e-9 of the disturbance, as is RK4's (0.1 / 4)^4 / 120 of a
    # mode; third orders are 1e-8 each time that it oscillates.
    ratios = random_ratios(seed=birds, birds=birds, members=1, spread=0.01)
    flock = flock_of(birds, ratios, coupling=coupling)
    state = equilibrium(flock)
    assert state.margin[0] > 0.05
    matrix = steady_jacobian(flock, state, 0)
    push = np.random.default_rng(birds).standard_normal(2 * birds)
    push[birds:] *= 0.05  # speeds oscillate as omega x
    seen = disturbed(ratios, push, coupling, dt=0.25, t_max=300.0, every=200)
    for record, deviation in enumerate(seen):
        expected = expm(matrix * 50.0 * record) @ push
        np.testing.assert_allclose(deviation, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("push", "watch"),
    [
        pytest.param([1, 0, -1], [1, 0, -1], id="bird 1 against bird 3"),
        pytest.param([1, -2, 1], [0.5, -1, 0.5], id="the leader against both"),
    ],
)
def test_oscillations_in_flight_have_the_rate_and_frequency_of_an_eigenvalue(push, watch):
    # Mirrored disturbances of a mirrored flock are one oscillation each, of a period of some 100.
    # What third orders do to a frequency, 1e-8 of it, and RK4 to 1e-9 of mu, is far below 1e-6.
    flock, state, _, _ = three_birds()
    found = eigenvalues(flock, state.spacing, state.speed)[0]
    pushed = np.concatenate([push, np.zeros(3)])
    seen = disturbed(np.ones((3, 1)), pushed, dt=0.25, t_max=600.0, every=40)
    mu = rate_and_frequency(seen[:, :3] @ np.array(watch), 10.0)
    assert abs(mu.imag) > 0.01
    assert mu.real < -1e-4
    assert np.abs(found - mu).min() < 1e-6 * abs(mu)


def test_a_common_change_of_speed_fades_as_an_eigenvalue_says():
    flock, state, _, _ = three_birds()
    found = eigenvalues(flock, state.spacing, state.speed)[0]
    pushed = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    seen = disturbed(np.ones((3, 1)), pushed, dt=1.0, t_max=2000.0, every=100)
    speeds = seen[:, 3:]
    assert np.ptp(speeds, axis=1).max() < 1e-6
    # exp(mu 100) from record to record; third orders are 1e-8.
    rates = np.diff(np.log(speeds[:, 1])) / 100.0
    np.testing.assert_allclose(rates, rates.mean(), rtol=1e-6)
    assert np.abs(found - rates.mean()).min() < 1e-6 * abs(rates.mean())


def test_formations_of_birds_near_the_standard_are_stable():
    ratio = 1.0 + 0.01 * np.random.default_rng(5).standard_normal((13, 1000))
    flock = flock_of(13, ratio)
    state = equilibrium(flock)
    leading = eigenvalues(flock, state.spacing, state.speed)[state.exists, 0]
    assert len(leading) > 400
    assert np.all(leading.real < 0.0)


def test_a_formation_of_birds_too_small_for_their_speed_need_not_be_stable():
    # Two birds slower than U_min: drag falls with speed, and what they save falls more slowly.
    flock = flock_of(2, [0.86, 0.86])
    state = equilibrium(flock)
    assert state.exists[0]
    assert eigenvalues(flock, state.spacing, state.speed)[0, 0].real > 0.0

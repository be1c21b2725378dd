# SPDX-License-Identifier: Apache-2.0
"""The flock's flight against an independent integration, and against its exact steady state."""

from itertools import pairwise
from math import log, log2, pi, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.aerodynamics import interaction_integral
from flock_sim.reference.integrator import Reference

EPS = 2.0**-52

# The goose by hand, Eqs. (hatk), (Gammamin) and the text under Eq. (scaling).
MASS = 3.8 / (1.225 * 0.75**3)
CRUISE = 18.5 / 18.0
K = 2.0 * 0.025 / 9.0
GAMMA = 4.0 * sqrt(0.8 * 0.025 / (pi * 9.0))
A = pi / 4.0
GAP = 1.0 + A  # lateral distance of two standard neighbours: 2 b + s_opt


def flown(**parameters) -> Reference:
    """A flock at the end of its flight."""
    flock = Reference(FlockConfiguration(**parameters))
    flock.advance(flock.configuration.steps)
    return flock


def shares(flock: Reference) -> np.ndarray:
    """D_{i,i-1} / C of every neighbouring pair of a homogeneous flock, tail to head."""
    even = log(1.0 - (2.0 * A / GAP) ** 2)
    return interaction_integral(np.diff(flock.position[:, 0]), GAP, A, A) / (2.0 * even)


# --- against an integrator and a right-hand side that share no line with ours ---

# 40 Gauss points over a wing whose integrand's nearest singularity is 0.1 or more of the half-span
# outside: error below 1.5^-80 = 1e-14.
POINTS, POINT_WEIGHTS = np.polynomial.legendre.leggauss(40)


def upwash_integral(x, y, source, target):
    """I by quadrature of v-hat, bound part brought to one denominator; x source minus target."""
    side = abs(y) + target * POINTS
    plus, minus = side + source, side - source
    far, near = np.hypot(x, plus), np.hypot(x, minus)
    bound = x * (plus**2 - minus**2) / (far * near * (plus * near + minus * far))
    trailing = (1.0 + x / far) / plus - (1.0 + x / near) / minus
    return target * POINT_WEIGHTS @ (bound + trailing)


def equations_of_motion(ratios, coupling):
    """The right-hand side of Eqs. (eom2) scaled, bird by bird and pair by pair."""
    birds = len(ratios)
    lateral = np.concatenate([[0.0], np.cumsum(ratios[:-1] + ratios[1:] + A - 1.0)])

    def derivative(_time, state):
        position, speed = state[:birds], state[birds:]
        circulation = ratios**2 * GAMMA / speed
        drag = K * (ratios**2 * speed**2 + ratios**4 / speed**2)
        thrust = ratios**4 * K * (CRUISE**2 + CRUISE**-2)
        for j in range(birds):
            for i in range(birds):
                if i != j and (coupling == "all" or abs(i - j) == 1):
                    integral = upwash_integral(
                        position[i] - position[j],
                        lateral[i] - lateral[j],
                        A * ratios[i],
                        A * ratios[j],
                    )
                    drag[j] += circulation[i] * circulation[j] / (4.0 * pi) * integral
        return np.concatenate([speed, (thrust - drag) / (ratios**3 * MASS)])

    return derivative


FLOCKS = [
    pytest.param(1, "nearest", ("1=1.3",), id="one large bird"),
    pytest.param(2, "nearest", (), id="two"),
    pytest.param(3, "nearest", (), id="three"),
    pytest.param(3, "all", (), id="three, all-to-all"),
    pytest.param(4, "nearest", ("2=0.9", "4=1.1"), id="four that differ"),
    pytest.param(5, "all", ("1=1.1", "3=0.8"), id="five that differ, all-to-all"),
]


@pytest.mark.parametrize(("birds", "coupling", "span_ratios"), FLOCKS)
def test_flight_is_that_of_an_independent_integration(birds, coupling, span_ratios):
    t_max = 200.0
    flock = flown(birds=birds, coupling=coupling, span_ratios=span_ratios, dt=0.125, t_max=t_max)
    ratios = flock.configuration.span_ratio[:, 0]
    start = [-abs(i - birds // 2) * GAP for i in range(birds)] + [CRUISE] * birds
    other = solve_ivp(
        equations_of_motion(ratios, coupling),
        (0.0, t_max),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    # Ours: 1e-9 at dt = 1 (see the order below) becomes 1e-9 / 8^4 at dt = 1/8. The other: 1e-13 of
    # positions up to 200 in each of some 50 steps, 1e-9, if all were to add up.
    position, speed = other.y[:birds, -1], other.y[birds:, -1]
    np.testing.assert_allclose(flock.position[:, 0], position, rtol=0, atol=1e-9)
    np.testing.assert_allclose(flock.speed[:, 0], speed, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("birds", "coupling", "span_ratios"), FLOCKS)
def test_a_perturbed_flight_is_that_of_an_independent_integration(birds, coupling, span_ratios):
    pushes = [  # (time, bird, change of position, change of speed), of both ends of the flight too
        (0.0, 1, 0.2, 0.0),
        (60.0, birds, -0.3, 0.02),
        (60.0, 1, 0.0, -0.03),
        (110.125, 1, 0.4, 0.01),
        (200.0, birds, 0.1, 0.01),
    ]
    dt, t_max = 0.125, 200.0
    flock = flown(
        birds=birds,
        coupling=coupling,
        span_ratios=span_ratios,
        dt=dt,
        t_max=t_max,
        perturbations=[f"{bird}@{round(time / dt)}={dx},{du}" for time, bird, dx, du in pushes],
    )
    ratios = flock.configuration.span_ratio[:, 0]
    state = np.array([-abs(i - birds // 2) * GAP for i in range(birds)] + [CRUISE] * birds)
    for time, until in pairwise([0.0, 60.0, 110.125, t_max, t_max]):
        for at, bird, dx, du in pushes:
            if at == time:
                state[bird - 1] += dx
                state[birds + bird - 1] += du
        if until > time:
            state = solve_ivp(
                equations_of_motion(ratios, coupling),
                (time, until),
                state,
                method="DOP853",
                rtol=1e-13,
                atol=1e-13,
            ).y[:, -1]
    # As above: what a push changes of the gaps is a part of what they change by in flight.
    np.testing.assert_allclose(flock.position[:, 0], state[:birds], rtol=0, atol=1e-9)
    np.testing.assert_allclose(flock.speed[:, 0], state[birds:], rtol=0, atol=1e-11)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [3, 5, 13])
def test_error_falls_with_the_fourth_power_of_the_step(birds, coupling):
    # Gaps move by 0.02 b a unit of time and forces change within 1 b: dt = 4 is well inside what a
    # Taylor series resolves, 8 no longer. At dt = 1/2 the error (5e-11) is still far above what
    # 256 steps' roundings of x ~ 128 leave (sqrt(256) * 1.4e-14 = 2e-13); the comparison flight has
    # (1/4)^4 of it, which moves the last order by log2(1 + 1/256) = 0.006.
    def end(dt):
        flock = flown(birds=birds, coupling=coupling, dt=dt, t_max=128.0)
        return np.concatenate([flock.position, flock.speed])

    exact = end(0.125)
    errors = [np.abs(end(dt) - exact).max() for dt in (4.0, 2.0, 1.0, 0.5)]
    orders = [log2(coarse / fine) for coarse, fine in pairwise(errors)]
    np.testing.assert_allclose(orders, 4.0, rtol=0, atol=0.1)


def test_the_default_step_is_fine_enough():
    coarse, fine = flown(dt=1.0, t_max=1000.0), flown(dt=0.01, t_max=1000.0)
    assert np.abs(coarse.position - fine.position).max() < 2e-8


# --- the steady state ---


def steady_speed(birds: int) -> float:
    """U*: the force balances of all birds added up, N (T - D(U)) = (N - 1) C(U)."""

    def surplus(speed):
        thrust, drag = K * (CRUISE**2 + CRUISE**-2), K * (speed**2 + speed**-2)
        pair = (GAMMA / speed) ** 2 / (2.0 * pi) * log(1.0 - (2.0 * A / GAP) ** 2)
        return birds * (thrust - drag) - (birds - 1) * pair

    return brentq(surplus, 1.0, 2.0, xtol=1e-15, rtol=4 * EPS)


# Positions near 1.3e5 are multiples of 2^-36. Birds keep their distances when each adds the same
# multiple in every step, so at dt = 1 the speeds of a steady flock may differ by that much.
SPEED_QUANTUM = 2.0**-36


@pytest.fixture(scope="module", params=[3, 7, 13, 31], ids=lambda birds: f"{birds} birds")
def settled(request) -> Reference:
    """A homogeneous flock at its steady state. Module-wide: 31 birds take a second to settle."""
    return flown(birds=request.param, t_max=1e5)


def test_steady_drags_fall_linearly_along_the_wing(settled):
    # Eq. (linear_general_x): D_{i,i-1} = C (1 - (i - 1) / N), on the left wing.
    birds = settled.configuration.birds
    head = formation.leader(birds)
    expected = 1.0 - np.arange(1, head) / birds
    assert np.abs(shares(settled)[: head - 1] - expected).max() < 1e-9


def test_steady_speed_balances_thrust_and_drag_of_the_whole_flock(settled):
    expected = steady_speed(settled.configuration.birds)
    assert settled.speed.mean() == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(settled.speed, expected, rtol=0, atol=SPEED_QUANTUM)


def test_steady_spacing_shrinks_from_tail_to_leader(settled):
    head = formation.leader(settled.configuration.birds)
    left = np.diff(settled.position[:head, 0])
    assert np.all(left > 0.0)
    assert np.all(np.diff(left) < 0.0)


def test_left_and_right_wing_mirror_each_other(settled):
    assert np.abs(settled.position - settled.position[::-1]).max() < 1e-8
    assert np.abs(settled.speed - settled.speed[::-1]).max() < 1e-8


@pytest.mark.parametrize("birds", [2, 4, 12])
def test_even_flocks_fly_and_settle(birds):
    # The same sums hold along the whole chain, D_{i,i-1} = C (1 - (i - 1) / N): the middle pair
    # shares alike, so two birds lead side by side.
    flock = flown(birds=birds, t_max=1e5)
    assert flock.speed.mean() == pytest.approx(steady_speed(birds), abs=1e-12)
    np.testing.assert_allclose(flock.speed, steady_speed(birds), rtol=0, atol=SPEED_QUANTUM)
    expected = 1.0 - np.arange(1, birds) / birds
    np.testing.assert_allclose(shares(flock), expected, rtol=0, atol=1e-9)
    middle = birds // 2
    assert abs(flock.position[middle - 1, 0] - flock.position[middle, 0]) < 1e-8


@pytest.mark.parametrize("ratio", [1.0, 1.1, 1.5])
def test_a_single_bird_cruises_at_its_solo_speed(ratio):
    flock = flown(birds=1, t_max=1e5, span_ratios=(f"1={ratio}",))
    # U_0,j of the text under Eq. (scaling); relaxation takes m / D'(U) < 6200, 16 times over.
    half = (CRUISE**2 + CRUISE**-2) / 2.0
    expected = sqrt(ratio**2 * half + sqrt(ratio**4 * half**2 - ratio**2))
    assert flock.speed[0, 0] == pytest.approx(expected, abs=1e-12)


def test_a_bird_with_no_solo_cruise_speed_is_carried_by_the_flock():
    # lambda H_0 = 0.999 * 1.0015 > 1 > 0.995 * 1.0015: alone it would slow down without end.
    flock = flown(birds=3, t_max=1e5, span_ratios=("2=0.995",))
    np.testing.assert_allclose(flock.speed, flock.speed[0, 0], rtol=0, atol=SPEED_QUANTUM)
    alone = flown(birds=1, t_max=1e5, span_ratios=("1=0.995",))
    assert not alone.speed[0, 0] > 0.9


# --- symmetry ---


@pytest.mark.parametrize("birds", [3, 6, 13])
def test_a_mirrored_flock_flies_mirrored(birds):
    # Nearest neighbours: a bird adds two drags, and a + b is b + a to the bit. Even flocks start
    # with the leader right of the middle, so their start is mirrored by hand.
    one = Reference(FlockConfiguration(birds=birds, t_max=500.0, span_ratios=("2=1.05",)))
    other = Reference(
        FlockConfiguration(birds=birds, t_max=500.0, span_ratios=(f"{birds - 1}=1.05",))
    )
    other.position[:] = one.position[::-1]
    one.advance(500)
    other.advance(500)
    np.testing.assert_array_equal(one.position, other.position[::-1])
    np.testing.assert_array_equal(one.speed, other.speed[::-1])


def test_only_differences_of_position_matter():
    here = Reference(FlockConfiguration(birds=5, coupling="all", t_max=200.0))
    there = Reference(here.configuration)
    there.position += 1000.0
    here.advance(200)
    there.advance(200)
    # 200 roundings of positions near 1200: half an ulp each, 1.1e-13, if all add up.
    np.testing.assert_allclose(
        there.position - 1000.0, here.position, rtol=0, atol=200 * 512 * EPS * 2
    )


def test_a_pair_side_by_side_stays_so():
    flock = Reference(FlockConfiguration(birds=3, coupling="all", t_max=1000.0, dt=0.5))
    flock.advance(2000)
    assert flock.position[0, 0] == flock.position[2, 0]


# --- members ---


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_members_fly_as_if_alone(coupling):
    ratios = ("0.95", "1.0", "1.05")
    together = flown(
        birds=5, coupling=coupling, t_max=300.0, span_ratios=("2=" + ",".join(ratios), "5=1.02")
    )
    for member, ratio in enumerate(ratios):
        alone = flown(birds=5, coupling=coupling, t_max=300.0, span_ratios=(f"2={ratio}", "5=1.02"))
        assert together.observe()[:, :, member].tobytes() == alone.observe()[:, :, 0].tobytes()


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200, -1e308])
@pytest.mark.parametrize("quantity", ["position", "speed"])
def test_a_member_that_diverges_changes_no_bit_of_the_others(quantity, value, coupling):
    configuration = FlockConfiguration(
        birds=4, coupling=coupling, t_max=50.0, span_ratios=("3=0.9,1.0,1.1",)
    )
    whole, hurt = Reference(configuration), Reference(configuration)
    getattr(hurt, quantity)[1, 1] = value
    recorded, unaffected = hurt.advance(50), whole.advance(50)
    assert not np.array_equal(recorded[..., 1], unaffected[..., 1], equal_nan=True)
    for member in (0, 2):
        assert recorded[..., member].tobytes() == unaffected[..., member].tobytes()


# --- recording ---


@pytest.mark.parametrize(("steps", "every"), [(1, 1), (10, 1), (10, 3), (9, 3), (5, 7)])
@pytest.mark.parametrize("rows", [1, 2, 1024])
def test_every_recorded_step_comes_once_whatever_is_held_at_once(steps, every, rows):
    configuration = FlockConfiguration(birds=3, t_max=float(steps), record_every=every)
    states = list(Reference(configuration).fly(rows=rows))
    assert [state.step for state in states] == list(range(0, steps + 1, every))
    # The same states as a flight that records every step.
    finest = list(Reference(FlockConfiguration(birds=3, t_max=float(steps), record_every=1)).fly())
    for state in states:
        for name in ("position", "speed", "circulation", "interaction_drag"):
            np.testing.assert_array_equal(getattr(state, name), getattr(finest[state.step], name))


def test_flight_starts_in_the_v_at_cruising_speed():
    state = next(Reference(FlockConfiguration(birds=5, t_max=1.0)).fly())
    expected = [-2 * GAP, -GAP, 0.0, -GAP, -2 * GAP]
    # tan(45 degrees) and the spacing are an ulp off each.
    np.testing.assert_allclose(state.position[:, 0], expected, rtol=4 * EPS, atol=0)
    np.testing.assert_array_equal(state.speed, CRUISE)
    np.testing.assert_allclose(state.circulation, GAMMA / CRUISE, rtol=4 * EPS)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_recorded_drag_is_the_sum_over_the_birds_felt(coupling):
    ratios = np.array([1.0, 0.9, 1.0, 1.2])
    configuration = FlockConfiguration(
        birds=4, coupling=coupling, t_max=40.0, span_ratios=("2=0.9", "4=1.2")
    )
    state = list(Reference(configuration).fly())[-1]
    lateral = np.concatenate([[0.0], np.cumsum(ratios[:-1] + ratios[1:] + A - 1.0)])
    for j in range(4):
        felt = [
            state.circulation[i, 0]
            * state.circulation[j, 0]
            / (4.0 * pi)
            * upwash_integral(
                state.position[i, 0] - state.position[j, 0],
                lateral[i] - lateral[j],
                A * ratios[i],
                A * ratios[j],
            )
            for i in range(4)
            if i != j and (coupling == "all" or abs(i - j) == 1)
        ]
        # The quadrature is good to 1e-14, see above; drags are 1e-3 and less.
        assert state.interaction_drag[j, 0] == pytest.approx(sum(felt), rel=1e-12)

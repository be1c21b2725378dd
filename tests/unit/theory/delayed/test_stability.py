# SPDX-License-Identifier: Apache-2.0
"""Roots of the characteristic equation with a lag: to 50 digits, by hand, counted, and flown."""

from math import pi

import mpmath
import numpy as np
import pytest
from mpmath import mp
from scipy.optimize import root

from flock_sim.theory.delayed.linearisation import MODELS
from flock_sim.theory.delayed.stability import (
    crossings,
    delayed_linearisation,
    growth,
    steady_flight,
)
from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.linear_stability import eigenvalues
from support.delayed_flights import DelayedFlight
from support.steady_flocks import (
    MASS,
    STRENGTH,
    A,
    K,
    across,
    drag,
    integral,
    positions_of,
    surplus,
)
from support.steady_states import flock_of, rate_and_frequency

MIXED = [1.002, 0.998, 1.004, 1.0]

CRITICAL_LINEAR = 41.787076604105
"""Lag at which three geese that move on what they see lose stability, in b / U_min."""


def closest(found, value):
    return np.min(np.abs(np.asarray(found) - value))


# --- the equations a second time ---


def accelerations(now, past, ratios, lag, model):
    """dU/dt of every bird from positions and speeds, and those and dU/dt a lag ago, in mpmath."""
    (position, speed), (was, had, gained) = now, past
    lateral, birds = across(ratios), len(ratios)
    seen, circulated = was, had  # at the speed `circulated` a bird has the circulation that is seen
    if model == "linear":
        seen = [x + lag * u for x, u in zip(was, had)]
        circulated = [1 / (1 / u - lag * a / u**2) for u, a in zip(had, gained)]
    force = [surplus(ratio, u) for ratio, u in zip(ratios, speed)]
    for j in range(birds):
        for i in (j - 1, j + 1):
            if 0 <= i < birds:
                force[j] -= drag(
                    seen[i] - position[j],
                    lateral[i] - lateral[j],
                    ratios[i],
                    ratios[j],
                    (circulated[i], speed[j]),
                    of=mp,
                )
    return [K * value / (MASS * ratio**3) for value, ratio in zip(force, ratios)]


def matrices(spacing, speed, ratios, lag, model):
    """d(dU/dt) by positions and speeds now, by these and dU/dt then: five of (N, N), 50 digits."""
    birds = len(ratios)
    ratios = [mp.mpf(float(ratio)) for ratio in ratios]
    lag, speed = mp.mpf(lag), mp.mpf(speed)
    position = [mp.mpf(float(x)) for x in positions_of(spacing)]
    speeds = [speed] * birds
    state = [*position, *speeds, *[x - speed * lag for x in position], *speeds, *[0] * birds]
    step = mp.mpf(10) ** -16
    found = [mp.matrix(birds, birds) for _ in range(5)]
    for column in range(5 * birds):
        sides = []
        for sign in (1, -1):
            moved = list(state)
            moved[column] += sign * step
            parts = [moved[k * birds : (k + 1) * birds] for k in range(5)]
            sides.append(accelerations(parts[:2], parts[2:], ratios, lag, model))
        for row in range(birds):
            value = (sides[0][row] - sides[1][row]) / (2 * step)
            found[column // birds][row, column % birds] = value
    return found


def determinant(parts, lag):
    """det Delta(lambda) / lambda, a function for mpmath, of the matrices above."""
    by_x, by_u, by_past_x, by_past_u, by_past_a = parts
    birds = by_x.rows

    def function(value):
        past = mp.exp(-value * lag)
        delta = value**2 * mp.eye(birds) - by_x - value * by_u
        seen = by_past_x + value * by_past_u + value**2 * by_past_a
        return mp.det(delta - past * seen) / value

    return function


CASES = [
    ("hold", [1.0] * 3, 0.3),
    ("hold", [1.0] * 3, 5.0),
    ("hold", MIXED, 0.2),
    ("linear", [1.0] * 3, 20.0),
    ("linear", [1.0] * 3, 80.0),
    ("linear", MIXED, 45.0),
    ("hold", [1.0] * 2, 2.0),
]


@pytest.mark.parametrize(("model", "ratios", "lag"), CASES)
def test_roots_are_roots_of_the_equations_in_50_digits(model, ratios, lag):
    # Entries of Delta are known to ten roundings; |lambda| is 0.02 and roots are some 1e-4 apart.
    # In as many digits, secants from a root that is nearly right end where it should be.
    flock = flock_of(len(ratios), ratios)
    motion = delayed_linearisation(flock, lag, model)
    found = motion.rightmost_roots(2 * len(ratios) - 1)
    assert np.all(np.diff(found.real) <= 0.0)
    with mpmath.workdps(50):
        parts = matrices(*steady_flight(flock, lag, model), ratios, lag, model)
        function = determinant(parts, mp.mpf(lag))
        for value in found:
            start = mp.mpc(complex(value))
            exact = mp.findroot(
                function, (start, start * (1 + mp.mpf(10) ** -9)), solver="secant", verify=False
            )
            assert abs(complex(exact) - value) < 1e-12 * motion.most_rapid + 1e-16


@pytest.mark.parametrize(("model", "ratios", "lag"), CASES)
def test_no_root_is_further_right(model, ratios, lag):
    # The phase of det Delta(lambda) / lambda turns once for every root inside of a contour. Here it
    # is the half disc in which all roots right of a line, halfway between two of them, must lie.
    flock = flock_of(len(ratios), ratios)
    motion = delayed_linearisation(flock, lag, model)
    with mpmath.workdps(50):
        parts = matrices(*steady_flight(flock, lag, model), ratios, lag, model)
    by_x, by_u, by_past_x, by_past_u, by_past_a = (
        np.array(part.tolist(), dtype=float).reshape(len(ratios), -1) for part in parts
    )
    found = motion.rightmost_roots(2 * len(ratios) - 1)
    gaps = found.real[:-1] - found.real[1:]
    left = int(np.argmax(gaps)) + 1  # roots on the right of the line
    line = 0.5 * (found.real[left - 1] + found.real[left])
    radius = 2.0 * motion.most_rapid * np.exp(-line * lag)
    low, up = complex(line, -radius), complex(line, radius)
    rows = np.linspace(0.0, 1.0, 20001)
    corners = [low, complex(radius, -radius), complex(radius, radius), up, low]
    contour = np.concatenate([a + (b - a) * rows[:-1] for a, b in zip(corners, corners[1:])])
    z = contour[:, np.newaxis, np.newaxis]
    delta = z**2 * np.eye(len(ratios)) - by_x - z * by_u
    delta = delta - np.exp(-z * lag) * (by_past_x + z * by_past_u + z**2 * by_past_a)
    values = np.linalg.det(delta) / contour
    turns = np.angle(np.append(values[1:], values[0]) / values)
    assert np.abs(turns).max() < 1.0  # the contour is fine enough
    assert round(turns.sum() / (2.0 * pi)) == left


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("birds", [1, 2, 3, 7])
def test_without_a_lag_roots_are_the_eigenvalues(birds, model):
    flock = flock_of(birds)
    state = equilibrium(flock)
    expected = eigenvalues(flock, state.spacing, state.speed)[0]
    found = delayed_linearisation(flock, 0.0, model).rightmost_roots(2 * birds - 1)
    assert len(found) == 2 * birds - 1
    assert all(closest(found, value) < 1e-12 for value in expected)
    # Of a short lag they are continuous: lambda lag = 1e-9 of it.
    near = delayed_linearisation(flock, 1e-7, model).rightmost_roots(2 * birds - 1)
    assert all(closest(near, value) < 1e-6 for value in expected)


# --- three birds by hand ---


def three(lag, model, ratio=1.0):
    """m, q, kappa, a, b of three equal birds: what follows, with s = D_21 = 2 D_12.

    Tail 1 answers to the leader 2 with a = -dD_21/dx, the leader to the tail with b = -dD_12/dx,
    each where it sees the other. kappa = s / U, q = Q - kappa.
    """
    flock = flock_of(3, [ratio] * 3)
    spacing, speed = steady_flight(flock, lag, model)
    late = speed * lag if model == "hold" else 0.0
    y, half = 2.0 * ratio + A - 1.0, A * ratio
    strength = 0.5 * K * STRENGTH * ratio**4 / speed**2
    with mpmath.workdps(30):
        a, b = (
            -strength * float(mp.diff(lambda x: integral(x, y, mp.mpf(half), mp.mpf(half), mp), x))
            for x in (spacing[0] - late, -spacing[0] - late)
        )
    kappa = strength * integral(spacing[0] - late, y, half, half) / speed
    q = 2.0 * K * (ratio**2 * speed - ratio**4 / speed**3) - kappa
    return MASS * ratio**3, q, kappa, a, b


def wings_alike(value, lag, model, constants):
    """(m z^2 + q z + a) (m z^2 + q z + 2 b) - e^(-2 z tau) w^2 (a + kappa z) (2 b + kappa z)."""
    m, q, kappa, a, b = constants
    on = 1.0 + value * lag if model == "linear" else 1.0
    own = m * value**2 + q * value
    seen = np.exp(-2.0 * value * lag) * on**2 * (a + kappa * value) * (2.0 * b + kappa * value)
    return (own + a) * (own + 2.0 * b) - seen


@pytest.mark.parametrize(
    ("model", "lag"), [("hold", 0.1), ("hold", 3.0), ("linear", 10.0), ("linear", 60.0)]
)
def test_three_birds_by_hand(model, lag):
    m, q, *_, a, _ = constants = three(lag, model)
    found = delayed_linearisation(flock_of(3), lag, model).rightmost_roots(5)
    # Wing against wing the leader is at rest, and nobody's lag matters.
    swing = (-q + np.emath.sqrt(q**2 - 4.0 * m * a)) / (2.0 * m)
    assert closest(found, swing) < 1e-14
    others = [value for value in found if min(abs(value - swing), abs(value - swing.conj())) > 1e-9]
    assert len(others) == 3
    for value in others:
        terms = abs(m * value**2) + abs(q * value) + a
        assert abs(wings_alike(value, lag, model, constants)) < 1e-12 * terms**2


# --- critical lags ---


def test_three_geese_that_move_on_what_they_see_lose_stability_once():
    found = crossings(flock_of(3), np.linspace(0.0, 200.0, 11), "linear")
    assert [(crossing.lost, crossing.frequency > 0.0) for crossing in found] == [(True, True)]
    constants = three(0.0, "linear")

    def real_and_imaginary(unknown):
        lag, frequency = unknown
        value = wings_alike(1j * frequency, lag, "linear", constants) / constants[3] ** 2
        return [value.real, value.imag]

    lag, frequency = root(real_and_imaginary, [40.0, 0.02], tol=1e-14).x
    # A root's real part is known to 1e-15 and changes by 5e-5 a lag.
    assert found[0].lag == pytest.approx(lag, abs=1e-9)
    assert found[0].frequency == pytest.approx(frequency, abs=1e-12)
    assert lag == pytest.approx(CRITICAL_LINEAR, abs=1e-9)


def lag_that_these_springs_would_need(constants):
    """The least lag with which the roots of `wings_alike` reach the imaginary axis, all else held.

    There |own| = |seen|, a polynomial in omega^2, and the phase of `seen` must make up for that of
    `own`. inf where none does.
    """
    m, q, kappa, a, b = constants
    square = np.polynomial.Polynomial([0.0, 1.0])  # omega^2
    own, seen = 1.0, 1.0
    for pull in (a, 2.0 * b):
        own = own * ((pull - m * square) ** 2 + q**2 * square)
        seen = seen * (pull**2 + kappa**2 * square)
    lags = [np.inf]
    for value in ((own - seen) // square).roots():
        if abs(value.imag) < 1e-9 * abs(value) and value.real > 0.0:
            z = 1j * np.sqrt(value.real)
            gain = (a + kappa * z) * (2.0 * b + kappa * z)
            gain /= (m * z**2 + q * z + a) * (m * z**2 + q * z + 2.0 * b)
            lags.append(np.angle(gain) % (2.0 * pi) / (2.0 * z.imag))
    return min(lags)


def test_three_geese_that_hold_what_they_see_never_lose_stability():
    # They see each other so far behind that their springs go slack: it would take 14.8 times the
    # lag at least, and beyond 35 no lag would do, the springs then being weaker than damping.
    lags = np.geomspace(1e-3, 35.0, 120)
    needed = np.array([lag_that_these_springs_would_need(three(lag, "hold")) for lag in lags])
    assert (needed / lags).min() == pytest.approx(14.8, abs=0.05)
    for lag in np.geomspace(35.0, 1e4, 60):
        m, q, kappa, a, b = three(lag, "hold")
        # |m z^2 + q z + p|^2 - |p + kappa z|^2 = omega^2 (m^2 omega^2 + q^2 - kappa^2 - 2 m p) > 0
        assert q**2 - kappa**2 > 2.0 * m * max(a, 2.0 * b)
    assert crossings(flock_of(3), [0.0, *np.geomspace(1e-2, 1e3, 40)], "hold") == []


def test_springs_that_knew_of_no_bias_would_need_little():
    # Were it not for the bias, 8.3 b / U_min would do: Q (a + 2 b) / (4 a b), but for terms of
    # (2 omega tau)^2.
    _, q, kappa, a, b = constants = three(0.0, "hold")
    needed = lag_that_these_springs_would_need(constants)
    assert needed == pytest.approx(8.3, abs=0.05)
    first_order = (q + kappa) * (a + 2.0 * b) / (4.0 * a * b)
    assert needed == pytest.approx(first_order, rel=(2.0 * needed * 0.0175) ** 2)


@pytest.mark.parametrize("birds", [2, 4, 5, 13])
def test_no_formation_of_equals_loses_stability_by_holding(birds):
    flock = flock_of(birds)
    assert all(growth(flock, lag, "hold") < 0.0 for lag in (0.1, 1.0, 10.0))


def test_birds_too_small_to_cruise_alone_lose_stability_by_holding():
    # The later they see each other, the less they save, and the nearer to U_min they get.
    flock = flock_of(3, [0.9] * 3)
    (found,) = crossings(flock, np.linspace(0.0, 0.45, 6), "hold")
    assert found.lost
    assert found.lag == pytest.approx(0.401105, abs=1e-6)
    constants = three(found.lag, "hold", ratio=0.9)
    value = wings_alike(1j * found.frequency, found.lag, "hold", constants)
    assert abs(value) < 1e-9 * constants[3] ** 2


# --- what is seen in flight ---


def flown_roots(ratio, lags, model, steps_a_lag, swings):
    """The root of the mode in which both wings of three move alike, from flights at `lags`.

    Half the difference of two flights pushed by 1e-4 either way: second orders drop out, third ones
    are 3e-7. What decays faster has had half of the flight for it.
    """
    push = 1e-4 * np.array([1.0, -2.0, 1.0])
    states = [steady_flight(flock_of(3, [ratio] * 3), lag, model) for lag in lags]
    position = np.array([positions_of(spacing) for spacing, _ in states]).T
    position = np.concatenate([position + push[:, np.newaxis], position - push[:, np.newaxis]], 1)
    speed = np.tile([speed for _, speed in states], (3, 2))
    flight = DelayedFlight(
        np.full(position.shape, ratio), position, speed, np.tile(lags, 2), model, steps_a_lag
    )
    root = delayed_linearisation(flock_of(3, [ratio] * 3), lags[0], model).rightmost_roots()[0]
    period = 2.0 * pi / abs(root.imag) / flight.dt[0]
    seen = flight.advance(round(swings * period))
    spread = np.einsum("tbm,b->tm", seen, [1.0, -2.0, 1.0])
    found = []
    for member in range(len(lags)):
        signal = spread[:, member] - spread[:, member + len(lags)]
        every = max(1, round(period / 8))
        late = signal[len(signal) // 2 :: every]
        found.append(rate_and_frequency(late, every * flight.dt[member]))
    return found


@pytest.mark.parametrize(
    ("model", "ratio", "critical", "steps", "swings"),
    [("linear", 1.0, CRITICAL_LINEAR, 20, 16), ("hold", 0.9, 0.401105, 1, 8)],
)
def test_flights_grow_on_one_side_of_the_critical_lag_and_fade_on_the_other(
    model, ratio, critical, steps, swings
):
    lags = critical * np.array([0.95, 0.99, 1.01, 1.05])
    flown = flown_roots(ratio, lags, model, steps, swings)
    for lag, value in zip(lags, flown):
        motion = delayed_linearisation(flock_of(3, [ratio] * 3), lag, model)
        expected = motion.rightmost_roots()[0]
        assert (value.real > 0.0) == (lag > critical) == (expected.real > 0.0)
        # Third orders, (1e-4 b over the 0.2 b in which forces change)^2 = 3e-7 of a frequency of
        # 0.02; 1 % from the critical lag the rate is 6e-6 or more.
        assert min(abs(value - expected), abs(value - expected.conj())) < 6e-9


# --- bad input ---


def test_without_a_steady_state_there_is_no_growth():
    flock = flock_of(3, [0.6, 1.0, 1.0])
    for model in MODELS:
        assert not delayed_linearisation(flock, 1.0, model).exists
        assert np.isnan(growth(flock, 1.0, model))


def test_only_known_models_lags_and_one_flock_at_a_time():
    for model in MODELS:
        with pytest.raises(ValueError, match="lag"):
            growth(flock_of(3), -1.0, model)
    with pytest.raises(ValueError, match="hold, linear"):
        growth(flock_of(3), 1.0, "square")
    two = flock_of(3, np.ones((3, 2)))
    with pytest.raises(ValueError, match="2 members"):
        growth(two, 1.0, "hold")

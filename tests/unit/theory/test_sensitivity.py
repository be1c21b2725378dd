# SPDX-License-Identifier: Apache-2.0
"""Derivatives of steady states, against differences of independent steady states in 40 digits."""

import mpmath
import numpy as np
import pytest
from mpmath import mp

from flock_sim.theory.equilibrium import equilibrium
from flock_sim.theory.sensitivity import sensitivity
from support.steady_flocks import H_0, across, forces, pairs, random_ratios, saved, surplus
from support.steady_states import flock_of

RELATIVE = 1e-9
"""As issued, relative to the largest derivative of its kind."""

DIGITS = 40

STEP = mpmath.mpf(10) ** -12
"""Central differences err by the square of it."""


def steady_state(ratios, coupling, thrusts, start):
    """U* and the spacings, where all forces are 0, found from `start`."""

    def all_forces(speed, *spacing):
        positions = [mp.mpf(0)]
        for gap in spacing:
            positions.append(positions[-1] + gap)
        return forces(positions, [speed] * len(ratios), ratios, coupling, thrusts=thrusts, of=mp)

    return list(mpmath.findroot(all_forces, start, tol=mp.mpf(10) ** -(2 * DIGITS - 10)))


def share_of(behind, ratios, speed, coupling, thrusts):
    """s_S of the birds (from 0) of the set S."""
    side = across(ratios)
    carried = sum(surplus(ratios[i], speed, H_0 * thrusts[i]) for i in behind)
    between = mp.mpf(0)
    for i, j in pairs(len(ratios), coupling):
        saving = saved(side[j] - side[i], ratios[i], ratios[j], speed, of=mp)
        if (i in behind) != (j in behind):
            between += saving
        elif i in behind:
            carried -= saving
    return carried / between


def differences(ratios, coupling, thrusts, state):
    """The derivatives of the first member of `state`: of speed, spacings, shares and margin."""
    birds = len(ratios)
    worst = [i for i in range(birds) if state.worst_set[i, 0]]
    start = [mp.mpf(state.speed[0]), *(mp.mpf(gap) for gap in state.spacing[:, 0])]

    def quantities(bird, step):
        changed = [mp.mpf(ratio) for ratio in ratios]
        changed[bird] += step
        speed, *spacing = steady_state(changed, coupling, thrusts, start)
        sets = [range(gap) for gap in range(1, birds)]
        share = [share_of(behind, changed, speed, coupling, thrusts) for behind in sets]
        margin = [1 - share_of(worst, changed, speed, coupling, thrusts)] if birds > 1 else []
        return [speed, *spacing, *share, *margin]

    columns = []
    for bird in range(birds):
        above, below = (quantities(bird, step) for step in (STEP, -STEP))
        columns.append([float((a - b) / (2 * STEP)) for a, b in zip(above, below)])
    return np.split(np.array(columns).T, [1, birds, 2 * birds - 1])


FLOCKS = [
    pytest.param(birds, coupling, seed, spread, id=f"{birds}-{coupling}-{seed}")
    for birds, coupling, seed, spread in [
        (1, "nearest", 1, 0.02),
        (1, "all", 1, 0.02),
        (2, "nearest", 2, 0.05),
        (2, "all", 2, 0.05),
        (3, "nearest", 4, 0.02),
        (3, "all", 5, 0.02),
        (4, "nearest", 9, 0.01),
        (4, "all", 7, 0.02),
        (5, "nearest", 1, 0.005),
        (5, "all", 8, 0.02),
        (8, "nearest", 1, 0.004),
        (4, "all", 0, 0.0),
        (5, "nearest", 0, 0.0),
    ]
]


@pytest.mark.parametrize(("birds", "coupling", "seed", "spread"), FLOCKS)
def test_derivatives_are_those_of_independent_steady_states(birds, coupling, seed, spread):
    ratios = random_ratios(seed, birds, 1, spread)[:, 0]
    # Half of the flocks have birds of other thrusts, too.
    thrusts = random_ratios(seed + 1, birds, 1, spread if seed % 2 else 0.0)
    flock = flock_of(birds, ratios, coupling=coupling)
    state = equilibrium(flock, thrusts)
    assert state.exists.all()
    found = sensitivity(flock, state)
    with mpmath.workdps(DIGITS):
        speed, spacing, share, margin = differences(
            ratios.tolist(), coupling, thrusts[:, 0].tolist(), state
        )
    for name, value, expected in (
        ("speed", found.speed_by_span, speed[0]),
        ("spacing", found.spacing_by_span, spacing),
        ("share", found.share_by_span, share),
        ("margin", found.margin_by_span, margin[0] if birds > 1 else np.full(1, np.nan)),
    ):
        assert value.shape == (1, *expected.shape), name
        largest = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(
            value[0], expected, rtol=0.0, atol=RELATIVE * largest, err_msg=name
        )


def test_each_member_has_its_own_derivatives_and_nan_without_a_state():
    for coupling in ("nearest", "all"):
        ratios = random_ratios(1, 5, 4, 0.01)
        ratios[2, 1] = 0.6
        flock = flock_of(5, ratios, coupling=coupling)
        state = equilibrium(flock)
        assert not state.exists[1]
        assert state.exists.any()
        found = vars(sensitivity(flock, state))
        for member, exists in enumerate(state.exists):
            alone = flock.select(np.array([member]))
            expected = vars(sensitivity(alone, equilibrium(alone)))
            for name, values in found.items():
                assert np.isnan(values[member]).all() != exists, name
                np.testing.assert_allclose(values[member], expected[name][0], rtol=1e-12)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_mirror_image_of_a_flock_has_mirrored_derivatives(coupling):
    ratios = random_ratios(3, 6, 1, 0.005)
    one = flock_of(6, ratios, coupling=coupling)
    other = flock_of(6, ratios[::-1], coupling=coupling)
    found, mirrored = sensitivity(one, equilibrium(one)), sensitivity(other, equilibrium(other))
    assert np.isfinite(found.speed_by_span).all()
    close = {"rtol": 1e-9, "atol": 1e-9}
    np.testing.assert_allclose(mirrored.speed_by_span[:, ::-1], found.speed_by_span, **close)
    np.testing.assert_allclose(
        -mirrored.spacing_by_span[:, ::-1, ::-1], found.spacing_by_span, **close
    )
    np.testing.assert_allclose(-mirrored.share_by_span[:, ::-1, ::-1], found.share_by_span, **close)
    np.testing.assert_allclose(mirrored.margin_by_span[:, ::-1], found.margin_by_span, **close)


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [13, 31])
def test_a_small_change_of_one_bird_changes_a_large_flock_as_its_derivatives_say(birds, coupling):
    # A central difference errs by the order of h^2, and by rounding over h.
    step = 1e-6
    flock = flock_of(birds, coupling=coupling)
    found = sensitivity(flock, equilibrium(flock))
    for bird in (0, birds // 2, birds - 2):
        ratios = np.ones((birds, 2))
        ratios[bird] += [step, -step]
        changed = equilibrium(flock_of(birds, ratios, coupling=coupling))
        for values, derivatives in (
            (changed.speed[np.newaxis], found.speed_by_span[0, [bird]]),
            (changed.spacing, found.spacing_by_span[0, :, bird]),
            (changed.share, found.share_by_span[0, :, bird]),
        ):
            difference = (values[:, 0] - values[:, 1]) / (2.0 * step)
            largest = np.abs(derivatives).max()
            np.testing.assert_allclose(difference, derivatives, rtol=0.0, atol=1e-6 * largest)

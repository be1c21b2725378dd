# SPDX-License-Identifier: Apache-2.0
"""Peaks of curves with known maxima, and of flocks against the bisection of Boyd and others."""

import numpy as np
import pytest

from flock_sim.response.frequencies import Frequencies
from flock_sim.response.linear_response import linear_response
from flock_sim.response.peaks import peaks
from support.linear_flocks import mixed_flock, responses, state_space


def test_maxima_are_found_to_rounding():
    # log(h / ((x - c)^2 + w^2)): the maximum log(h / w^2) is at c.
    centre = np.array([0.3, 0.7, 0.7000001])
    width = np.array([1e-2, 1e-4, 1e-4])
    height = np.array([1.0, 1e-3, 1.0])

    def curves(x):
        square = (x[:, np.newaxis] - centre) ** 2 + width**2
        return np.log(height / square), -2.0 * (x[:, np.newaxis] - centre) / square

    x = np.linspace(0.0, 1.0, 38)
    found = peaks(curves, x, *curves(x))
    np.testing.assert_allclose(found.frequency, centre, rtol=1e-14)
    np.testing.assert_allclose(found.value, np.log(height / width**2), rtol=1e-14)


def test_the_highest_of_several_maxima_counts():
    def curves(x):
        return (
            np.sin(20.0 * x)[:, np.newaxis] + x[:, np.newaxis],
            20.0 * np.cos(20.0 * x)[:, np.newaxis] + 1.0,
        )

    x = np.linspace(0.0, 0.9, 60)
    found = peaks(curves, x, *curves(x))
    # cos(20 x) = -1 / 20, in the last period
    place = (4.0 * np.pi + np.arccos(-0.05)) / 20.0
    assert found.frequency[0] == pytest.approx(place, rel=1e-13)
    assert found.value[0] == pytest.approx(np.sin(20.0 * place) + place, rel=1e-14)


def test_a_curve_that_only_falls_is_highest_at_its_start():
    x = np.linspace(0.0, 1.0, 5)
    values, slopes = -(x[:, np.newaxis] ** 2), -2.0 * x[:, np.newaxis]
    found = peaks(lambda at: (None, None), x, values, slopes)
    assert (found.value[0], found.frequency[0]) == (0.0, 0.0)


def crosses(gain, matrix, force, output):
    """Whether a singular value of the transfer equals `gain` at a frequency.

    It does exactly if the Hamiltonian matrix has an imaginary eigenvalue (Boyd, Balakrishnan,
    Kabamba 1989). The states are scaled to like size first.
    """
    hamiltonian = np.block([[matrix, force @ force.T / gain**2], [-output.T @ output, -matrix.T]])
    values = np.linalg.eigvals(hamiltonian)
    return np.abs(values.real).min() < 1e-9


def norm_by_bisection(matrix, force, output):
    """The H-infinity norm, to 1e-6 relative: between those Hamiltonians."""
    scale = np.where(np.arange(len(matrix)) < len(output), 0.02, 1.0)
    matrix, force = scale[:, np.newaxis] * matrix / scale, scale[:, np.newaxis] * force
    output = output / scale
    low = np.linalg.norm(output @ np.linalg.solve(matrix, force), 2)
    high = low
    while crosses(high, matrix, force, output):
        high *= 2.0
    # Imaginary eigenvalues appear below the norm.
    while high > low * (1.0 + 1e-6):
        middle = np.sqrt(low * high)
        if crosses(middle, matrix, force, output):
            low = middle
        else:
            high = middle
    return low


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [2, 3, 6, 13])
def test_the_norm_is_that_of_the_bisection(birds, coupling):
    flock = mixed_flock(birds, coupling)
    matrix, force = state_space(flock)
    output = np.eye(birds - 1, 2 * birds - 1)
    found = linear_response(flock)
    expected = norm_by_bisection(matrix, force, output)
    assert found.hinf_gaps[0] == pytest.approx(expected, rel=3e-6)
    leader = force[:, [birds // 2]]
    expected = norm_by_bisection(matrix, leader, output)
    assert found.hinf_gaps_from_leader[0] == pytest.approx(expected, rel=3e-6)


@pytest.mark.parametrize(("lag", "model"), [(0.0, "linear"), (20.0, "linear"), (20.0, "hold")])
@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize(("birds", "seed"), [(5, 1), (8, 2), (13, 3)])
def test_no_frequency_has_a_higher_gain(birds, seed, coupling, lag, model):
    flock = mixed_flock(birds, coupling, seed)
    curves = responses(flock, lag, model)
    found = linear_response(flock, lag=lag, model=model)
    assert found.stable[0]
    resolved = Frequencies.of(curves).omega
    omega = np.concatenate([np.linspace(0.0, 0.03, 4001), np.geomspace(1e-7, 0.3, 500), resolved])
    gains = curves.followings(omega)[0]
    outer = [j if j < birds // 2 else j + 1 for j in range(birds - 1)]
    inner = [j + 1 if j < birds // 2 else j for j in range(birds - 1)]

    def of_neighbours(gains):
        return gains[:, outer] - gains[:, inner]

    for name, curve in (("speed", lambda gains: gains), ("neighbour", of_neighbours)):
        peak = getattr(found, f"{name}_gain_peak")[0]
        assert np.all(peak >= np.exp(curve(gains).max(axis=0)) * (1.0 - 1e-12))
        # Each peak is reached at its frequency.
        reached = curve(curves.followings(getattr(found, f"{name}_gain_frequency")[0])[0])
        np.testing.assert_allclose(peak, np.exp(np.diag(reached)), rtol=1e-12)
    for name, curve in (("", curves.largest_gains), ("_from_leader", curves.from_leader)):
        peak = getattr(found, f"hinf_gaps{name}")[0]
        assert peak >= np.exp(curve(omega)[0].max()) * (1.0 - 1e-12)
        at = getattr(found, f"hinf_gaps{name}_frequency")
        assert peak == pytest.approx(np.exp(curve(at)[0][0]), rel=1e-12)

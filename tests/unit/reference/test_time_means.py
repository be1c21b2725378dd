# SPDX-License-Identifier: Apache-2.0
"""The recorded means are over all steps, whatever steps are recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.state import MEANS, VALUES
from flock_sim.reference.integrator import Reference

FLOWN = {
    "plain, pushed": FlockConfiguration(
        birds=5, t_max=210.0, perturbations=("2@0=0.1", "3@21=0.3,-0.01", "4@50=-0.2")
    ),
    "all-to-all, members": FlockConfiguration(
        birds=4, coupling="all", t_max=210.0, dt=0.5, span_ratios=("2=0.9,1.0,1.1",)
    ),
    "held, lossy, noisy": FlockConfiguration(
        birds=5,
        t_max=210.0,
        links=("hold:interval=10,drop=0.3,position_noise=0.05",),
        perturbations=("1@3=0.1",),
    ),
}


def states(configuration: FlockConfiguration, every: int):
    return list(Reference(replace(configuration, record_every=every)).fly())


@pytest.mark.parametrize("every", [1, 7, 10, 210])
@pytest.mark.parametrize("flown", FLOWN.values(), ids=FLOWN)
def test_a_record_has_the_means_over_the_steps_since_the_one_before(flown, every):
    each = states(flown, 1)
    for state in states(flown, every):
        first = max(state.step - every + 1, 0) if state.step else 0
        steps = each[first : state.step + 1]
        for value, mean in zip(("speed", "interaction_drag"), MEANS, strict=True):
            # In the order of the steps, as the kernel adds.
            total = np.zeros_like(state.speed)
            for step in steps:
                total = total + getattr(step, value)
            np.testing.assert_array_equal(getattr(state, mean), total / len(steps))


def test_the_means_do_not_change_the_flight():
    flown = FLOWN["held, lossy, noisy"]
    each = {state.step: state for state in states(flown, 1)}
    for state in states(flown, 10):
        for name in VALUES:
            np.testing.assert_array_equal(getattr(state, name), getattr(each[state.step], name))


def test_the_mean_of_a_held_neighbour_does_not_depend_on_the_recorded_steps():
    # Recorded every 10 steps, the steps of a fresh message alone are seen: 17 % of drag saved.
    flown = FlockConfiguration(birds=5, t_max=2100.0, links=("hold:interval=10",))
    means, at_times = [], []
    for every in (1, 7, 10, 100):
        rows = [state for state in states(flown, every) if state.step > 1400]
        means.append(np.mean([row.mean_interaction_drag for row in rows]))
        at_times.append(np.mean([row.interaction_drag for row in rows]))
    assert max(means) - min(means) <= 0.01 * abs(means[0])
    assert max(at_times) - min(at_times) > abs(means[0])


def test_the_state_in_between_has_the_means_since_the_last_record():
    flown = replace(FLOWN["plain, pushed"], record_every=10)
    flight, each = Reference(flown), states(flown, 1)
    for step in range(36):
        if step in (0, 3, 10, 11, 35):
            since = (step - 1) // 10 * 10 + 1 if step else 0
            expected = np.mean([row.speed for row in each[since : step + 1]], axis=0)
            np.testing.assert_allclose(flight.observe()[4], expected, rtol=1e-14)
        flight.advance(1)

# SPDX-License-Identifier: Apache-2.0
"""The summary agrees with the metrics, for every flock that can be flown."""

from dataclasses import replace

import numpy as np
import pytest

from flock_sim.analysis.flight_verdict import Flown
from flock_sim.analysis.metrics import Metrics, measure
from flock_sim.analysis.summary import MOST_MEMBERS, summary
from flock_sim.analysis.time_means import Averaging
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.physics.flock_state import FlockState
from flock_sim.reference.integrator import Reference


def metrics_of(configuration: FlockConfiguration) -> Metrics:
    *_, end = Reference(configuration).fly()
    return measure(configuration, end)


def told(configuration: FlockConfiguration, states: list[FlockState]) -> str:
    """The summary of a flight that ends with the last of `states`."""
    means = Averaging(configuration, states[-1].time, None)
    for state in states:
        values = np.stack([state.mean_speed, state.mean_interaction_drag], axis=1)
        birds = np.arange(configuration.birds)
        means.add(birds, np.full(configuration.birds, state.step), values)
    verdicts = Flown(configuration, states).verdicts()
    return summary(measure(configuration, states[-1]), means.result(), verdicts)


def summary_of(configuration: FlockConfiguration) -> str:
    return told(configuration, list(Reference(configuration).fly()))


def summary_at(configuration: FlockConfiguration, state: FlockState) -> str:
    return told(configuration, [state])


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("birds", [1, 2, 3, 4, 5, 6, 7, 8, 31])
def test_every_size_of_flock_has_a_summary(birds: int, coupling: str) -> None:
    text = summary_of(FlockConfiguration(birds=birds, coupling=coupling, t_max=20.0))
    assert text.startswith(f"{birds} bird{'s' if birds > 1 else ''}, {coupling} coupling, t = 20 ")
    assert ("spacing" in text) == (birds > 1)
    assert ("hierarchy" in text) == (birds >= 4)
    assert ("linear law" in text) == (birds % 2 == 1 and birds > 1 and coupling == "nearest")
    assert max(len(line) for line in text.splitlines()) <= 120


def test_wings_that_mirror_each_other_are_told_once() -> None:
    alike = summary_of(FlockConfiguration(birds=7, t_max=50.0))
    assert "left wing" in alike
    assert "right wing" not in alike
    unlike = summary_of(FlockConfiguration(birds=7, t_max=50.0, span_ratios=("2=1.1",)))
    assert "right wing" in unlike


def test_the_right_wing_is_told_from_its_tail() -> None:
    configuration = FlockConfiguration(birds=5)
    position = np.array([[0.0], [3.0], [4.0], [3.5], [1.5]])
    state = FlockState(0, 0.0, position, *4 * [np.ones((5, 1))], np.zeros((5, 1)))
    text = summary_at(configuration, state)
    (left,) = (line for line in text.splitlines() if "spacing, left wing" in line)
    (right,) = (line for line in text.splitlines() if "spacing, right wing" in line)
    assert left.split()[3:5] == ["3.0000", "1.0000"]
    assert right.split()[3:5] == ["2.0000", "0.5000"]


def test_all_spacings_of_a_large_flock_are_told() -> None:
    configuration = FlockConfiguration(birds=41, t_max=20.0)
    metrics, text = metrics_of(configuration), summary_of(configuration)
    for spacing in metrics.spacing[0][:20]:
        assert f"{spacing:.4f}" in text


def test_of_many_members_the_first_are_told_and_all_are_counted() -> None:
    ratios = ",".join(f"{1 + 0.001 * m:g}" for m in range(20))
    configuration = FlockConfiguration(birds=3, t_max=20.0, span_ratios=(f"1={ratios}",))
    metrics, text = metrics_of(configuration), summary_of(configuration)
    assert f"member {MOST_MEMBERS}\n" in text
    assert f"member {MOST_MEMBERS + 1}\n" not in text
    assert f"20 members: 20 settling; {sum(metrics.stable)} with sigma_U < 0.0001" in text


def state_with(spacing: list[float], configuration: FlockConfiguration, step: int) -> FlockState:
    """A flock of equal speeds; spacings are those forward to the next bird, from tail to tail."""
    head = configuration.birds // 2
    signed = np.array(spacing) * np.where(np.arange(len(spacing)) < head, 1.0, -1.0)
    position = np.concatenate([[0.0], np.cumsum(signed)])[:, np.newaxis]
    ones = np.ones_like(position)
    return FlockState(
        step, step * configuration.dt, position, ones, ones, 0.0 * ones, ones, 0.0 * ones
    )


@pytest.mark.parametrize(
    ("spacing", "told"),
    [
        ([3.0, 1.0, 1.0, 3.0], "spacing falls from tail to leader"),
        ([1.0, 3.0, 3.0, 1.0], "spacing does not fall from tail to leader"),
        ([3.0, 1.0, 3.0, 1.0], "spacing falls from tail to leader on the left wing only"),
        ([1.0, 3.0, 1.0, 3.0], "spacing falls from tail to leader on the right wing only"),
        ([3.0, 2.0, 1.0], "spacing falls from tail to leader"),
    ],
)
def test_the_order_of_spacings_is_told_of_both_wings(spacing: list[float], told: str) -> None:
    configuration = FlockConfiguration(birds=len(spacing) + 1)
    text = summary_at(configuration, state_with(spacing, configuration, 1000))
    assert any(line.endswith(f"  {told}") for line in text.splitlines())


def test_equal_speeds_of_the_start_are_no_verdict() -> None:
    configuration = FlockConfiguration(birds=3)
    text = summary_at(configuration, state_with([2.0, 2.0], configuration, 0))
    assert "verdict              settling: " in text
    assert "(stable by the paper's criterion, < 0.0001)" in text


def test_the_means_are_told_with_their_time() -> None:
    text = summary_of(FlockConfiguration(birds=3, t_max=500.0))
    assert "mean over time " in text
    assert "(t = 450 to 500)" in text


def test_a_bag_of_an_earlier_version_has_no_means() -> None:
    configuration = FlockConfiguration(birds=3)
    unknown = np.full((3, 1), np.nan)
    state = state_with([2.0, 2.0], configuration, 0)
    state = replace(state, mean_speed=unknown, mean_interaction_drag=unknown)
    assert "not in this bag, whose states have no means" in summary_at(configuration, state)


@pytest.mark.filterwarnings("error")
def test_a_flock_that_is_not_finite_has_a_summary() -> None:
    nothing = np.full((3, 1), np.nan)
    text = summary_at(FlockConfiguration(birds=3), FlockState(0, 0.0, *6 * [nothing]))
    assert "stalled: the speed of bird 1 is not above 0 at t = 0" in text
    assert "not stable by the paper's criterion" in text


def test_what_cannot_be_saved_alone_has_no_sign() -> None:
    text = summary_of(FlockConfiguration(birds=1, t_max=10.0))
    assert "mean drag reduction  0.00 %" in text


@pytest.mark.parametrize("until", [-8e306, -1.0, 12.0, 1e308, np.inf, np.nan])
def test_means_up_to_a_time_outside_of_the_flight_are_refused(until: float) -> None:
    configuration = FlockConfiguration(birds=3, t_max=10.0)
    with pytest.raises(FlockError, match="must be 0 to t_max = 10"):
        Averaging(configuration, until, None)

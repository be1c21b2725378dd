# SPDX-License-Identifier: Apache-2.0
"""Python values become the same configuration as its text."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import flockflight as ff
from flock_sim import FlockConfiguration

RATIOS = st.floats(0.8, 1.2)


@given(
    arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 4)), elements=RATIOS),
    st.sampled_from(["nearest", "all"]),
)
def test_spans_are_kept_to_the_bit(spans: np.ndarray, coupling: str) -> None:
    as_array = ff.Flock(spans=spans, coupling=coupling).configuration
    by_bird = ff.Flock(len(spans), spans=dict(enumerate(spans, 1)), coupling=coupling).configuration
    assert as_array == by_bird
    assert as_array.coupling == coupling
    np.testing.assert_array_equal(as_array.span_ratio, spans)


def test_one_number_for_each_bird_tells_their_number() -> None:
    assert ff.Flock(spans=[1, 0.95, 1]).configuration == FlockConfiguration(
        birds=3, span_ratios=("1=1.0", "2=0.95", "3=1.0")
    )
    assert ff.Flock().configuration == FlockConfiguration()
    assert ff.Flock(np.int64(5), dt=np.float64(0.5)).configuration == FlockConfiguration(
        birds=5, dt=0.5
    )


def test_links_forces_and_pushes_are_entries_of_the_configuration() -> None:
    flock = ff.Flock(
        4,
        links=[
            ff.Link("hold", delay=[0, 5], drop=0.125),
            ff.Link("linear", interval=np.int64(3), source=2, target=1),
            "3->4=hold",
        ],
        forcing=ff.Force("gust", std=np.array([1e-5, 3e-5]), seed=7),
        pushes=[ff.Push(3, step=20, speed=-0.01), ff.Push(2, 40, position=1 / 3, member=2)],
    )
    assert flock.configuration == FlockConfiguration(
        birds=4,
        links=("hold:delay=0/5,drop=0.125", "2->1=linear:interval=3", "3->4=hold"),
        forcing=("gust:std=1e-05/3e-05,seed=7",),
        perturbations=("3@20=0.0,-0.01", f"2:2@40={1 / 3!r},0.0"),
    )
    assert flock.configuration.members == 2
    assert repr(flock).startswith("<Flock: 4 birds, nearest coupling, 2 members: 3@20=0.0,-0.01 ")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"birds": 0}, "birds = 0"),
        ({"spans": {14: 0.9}}, "bird 14 is not among 1..13"),
        ({"spans": {3: "small"}}, r"spans\[3\] = 'small': must be a number"),
        ({"birds": 3, "spans": [1, 1]}, r"spans of shape \(2,\): must have one row for each"),
        ({"spans": [[[1]]]}, r"shape \(1, 1, 1\)"),
        ({"coupling": "all-to-all"}, "all"),
        ({"t_mx": 3}, "unknown argument 't_mx': did you mean 't_max'"),
        ({"span": {3: 0.9}}, "did you mean 'spans'"),
        ({"delay": 5}, r"delay is of a link: pass links=Link\(MODEL, delay=...\)"),
        ({"span_ratios": ["3=1"]}, "span_ratios is called `spans` here"),
        ({"perturbations": []}, "perturbations is called `pushes` here"),
        ({"links": 5}, "links = 5: must be a list of Link or of text"),
        ({"links": [5]}, "links: 5 must be a Link or text"),
        ({"links": ff.Link("hodl")}, "did you mean 'hold'"),
        ({"links": ff.Link("hold", dealy=3)}, "did you mean 'delay'"),
        ({"forcing": ff.Force("gusts", std=1)}, "did you mean 'gust'"),
        ({"forcing": ff.Link("hold")}, "forcing = <Link hold>: must be a list of Force or of text"),
        ({"pushes": ff.Push(3, step=-1)}, "step -1"),
    ],
)
def test_a_bad_value_is_named(given: dict[str, Any], told: str) -> None:
    with pytest.raises(ff.FlockError, match=told):
        ff.Flock(**given)


def test_a_link_has_both_ends_or_none() -> None:
    with pytest.raises(ff.FlockError, match="both `source` and `target`"):
        ff.Link("hold", source=3)
    with pytest.raises(ff.FlockError, match="must be the name of a model"):
        ff.Link(5)  # type: ignore[arg-type]
    with pytest.raises(ff.FlockError, match=r"bird = \[1, 2\]: must be one whole number"):
        ff.Force("gust", std=1, bird=[1, 2])  # type: ignore[arg-type]
    with pytest.raises(ff.FlockError, match="std = None: must be a number"):
        ff.Force("gust", std=None)

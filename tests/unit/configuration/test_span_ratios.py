# SPDX-License-Identifier: Apache-2.0
"""Span ratios are the same numbers as text and as an array."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from flock_sim.configuration import span_ratios
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.span_ratios import array, entries, parted
from flock_sim.errors import FlockError

SPAN_RATIOS = arrays(
    np.float64, array_shapes(min_dims=2, max_dims=2, max_side=6), elements=st.floats(0.6, 1e300)
)


@given(SPAN_RATIOS)
def test_entries_are_read_as_the_array_that_they_are_made_from(span_ratio):
    again = array(entries(span_ratio), len(span_ratio))
    assert again.tobytes() == span_ratio.tobytes()
    assert again.shape == span_ratio.shape


def test_an_entry_has_a_bird_and_the_text_of_its_ratios():
    assert parted("04=1.050,1e0") == (4, "1.050,1e0")


@pytest.mark.parametrize("members", [{"span_ratios": ["4=1,1.1"]}, {"links": ["hold:delay=1/2"]}])
def test_more_members_than_memory_holds_are_refused(members, monkeypatch):
    assert FlockConfiguration.from_parameters(members).members == 2
    monkeypatch.setattr(span_ratios, "MOST_WINGS", 25)
    with pytest.raises(FlockError, match=r"^13 birds x 2 members: must be 25 wings or less"):
        FlockConfiguration.from_parameters(members)

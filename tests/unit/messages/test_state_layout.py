# SPDX-License-Identifier: Apache-2.0
"""Serialised states are read many at once with the values that decoding gives."""

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.state_layout import (
    Layout,
    fields_of,
    forcing_states_of,
    layout_of,
    members_of,
    values_of,
)
from flock_sim.messages.types import State


@pytest.mark.parametrize("members", [1, 2, 7])
def test_the_fields_are_those_of_decoded_states(members: int) -> None:
    chance = np.random.default_rng(members)
    states = [
        State.at(FlockConfiguration(dt=0.25), step, *chance.standard_normal((6, members))).encode()
        for step in (0, 3, 4000)
    ]
    assert [members_of(data) for data in states] == 3 * [members]
    step, time, values = fields_of(b"".join(states), Layout(members))
    decoded = [State.decode(data) for data in states]
    assert step.tolist() == [state.step for state in decoded]
    assert time.tolist() == [state.time for state in decoded]
    expected = [[getattr(state, name) for name in ARRAYS] for state in decoded]
    assert np.array_equal(values, expected)
    assert np.array_equal(values_of(states, members), expected)


@pytest.mark.parametrize(("members", "numbers"), [(1, 1), (1, 3), (2, 2), (7, 1)])
def test_the_forcing_states_are_those_of_decoded_states(members: int, numbers: int) -> None:
    chance = np.random.default_rng(members)
    forced = chance.standard_normal((3, numbers, members))
    states = [
        State.at(FlockConfiguration(), step, *chance.standard_normal((6, members)), own.ravel())
        for step, own in enumerate(forced)
    ]
    encoded = [state.encode() for state in states]
    assert {layout_of(data) for data in encoded} == {Layout(members, numbers * members)}
    assert np.array_equal(forcing_states_of(encoded, numbers, members), forced)
    expected = [[getattr(state, name) for name in ARRAYS] for state in states]
    assert np.array_equal(values_of(encoded, members), expected)
    plain = State.at(FlockConfiguration(), 9, *np.ones((6, members))).encode()
    mixed = forcing_states_of([encoded[0], plain], numbers, members)
    assert np.array_equal(mixed[0], forced[0])
    assert np.isnan(mixed[1]).all()

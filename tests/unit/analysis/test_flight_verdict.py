# SPDX-License-Identifier: Apache-2.0
"""The verdict on a flight needs its recorded states."""

from __future__ import annotations

import pytest

from flock_sim.analysis.flight_verdict import Flown, flight_verdicts
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.reference.integrator import Reference


def test_a_flight_without_states_at_their_times_has_no_verdict() -> None:
    # A damaged bag may hold states at other times than those that they state.
    configuration = FlockConfiguration(birds=3, t_max=20.0, record_every=1)
    first, *_, last = Reference(configuration).fly()
    with pytest.raises(FlockError, match="no complete state at the times of steps 10 to 20"):
        flight_verdicts(Flown(configuration, [first]), last, ())

# SPDX-License-Identifier: Apache-2.0
"""The terms of a grant can be read back: what is flown, and whether it is flown freely."""

from __future__ import annotations

import json

import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.handshake import handshake, read_handshake

FLOCK = FlockConfiguration(birds=3, coupling="all", span_ratios=("1=0.9,1.0",), t_max=100.0)


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0])
def test_terms_are_read_as_they_were_written(factor: float) -> None:
    assert read_handshake(handshake(FLOCK, factor)) == (FLOCK, factor)


@pytest.mark.parametrize("said", ["", "[1]", "1", "[" * 100_000])
def test_other_text_is_refused(said: str) -> None:
    with pytest.raises(ValueError, match=r"terms|Expecting|nested too deep"):
        read_handshake(said)


@pytest.mark.parametrize("factor", [-1.0, True, "2", None, float("nan"), float("inf"), 10**400])
def test_a_factor_that_no_flight_has_is_refused(factor: object) -> None:
    said = json.dumps({**FLOCK.parameters(), "real_time_factor": factor})
    with pytest.raises(ValueError, match="real-time factor"):
        read_handshake(said)


def test_a_key_of_another_version_is_named() -> None:
    with pytest.raises(FlockError, match="unknown parameter 'wind'"):
        read_handshake(json.dumps({**FLOCK.parameters(), "wind": 1.0}))

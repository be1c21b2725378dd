# SPDX-License-Identifier: Apache-2.0
"""Golden flights over real nodes have the digests that are committed for the flight in one loop."""

from __future__ import annotations

from pathlib import Path

import pytest

from flock_sim.recording.run import Run
from flock_tools.testing import fly
from support.golden_flights import FLIGHTS, committed_digests, digest_of


@pytest.mark.parametrize(
    "name",
    [
        "one bird",
        "unequal birds, all-to-all",
        "another bird",
        "pushes",
        "members that diverge",
        "lost messages of every stage",
        "links of single pairs",
    ],
)
def test_a_golden_flight_over_ros_has_the_committed_digest(name: str, tmp_path: Path) -> None:
    fly(FLIGHTS[name], output=tmp_path / "flight")
    with Run(tmp_path / "flight") as run:
        assert digest_of(run.snapshots()) == committed_digests()[name]
        assert run.state_digest == f"sha256:{committed_digests()[name]}"

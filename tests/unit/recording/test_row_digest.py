# SPDX-License-Identifier: Apache-2.0
"""The digest of serialised rows is that of the states in them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flock_sim.analysis.state_digest import StateDigest
from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.reference_flight import row
from flock_sim.messages import topics
from flock_sim.messages.types import State
from flock_sim.physics.flock_state import FlockState
from flock_sim.recording import row_digest
from flock_sim.recording.row_digest import RowDigest, digest_of
from flock_sim.reference.integrator import Reference
from support.flights import record

CONFIGURATION = FlockConfiguration(birds=3, t_max=60.0, record_every=2, span_ratios=("2=1,1.05",))
FLOWN = list(Reference(CONFIGURATION).fly())
ROWS = [row(CONFIGURATION, state).states for state in FLOWN]


def of(states: list[FlockState]) -> str:
    digest = StateDigest()
    for state in states:
        digest.add(state)
    return f"sha256:{digest.hexdigest()}"


def watched(messages: list[tuple[int, bytes]]) -> RowDigest:
    """Return the digest of messages, given as bird and state, of which each is passed on."""
    digest = RowDigest(CONFIGURATION)
    given = [(topics.state_topic(bird), 0, data) for bird, data in messages]
    assert list(digest.watch(given)) == given
    return digest


MESSAGES = [(bird, data) for states in ROWS for bird, data in enumerate(states, start=1)]


@pytest.mark.parametrize("batch", [1, 1000, 1 << 16])
def test_rows_have_the_digest_of_their_states(monkeypatch: pytest.MonkeyPatch, batch: int) -> None:
    monkeypatch.setattr(row_digest, "BATCH", batch)
    digest = RowDigest(CONFIGURATION)
    assert digest.text is None
    for number, (states, state) in enumerate(zip(ROWS, FLOWN, strict=True), start=1):
        digest.add(states)
        assert digest.rows == number
        if number % 10 == 1:
            assert digest.text == of(FLOWN[:number]), state.step
    assert digest.text == of(FLOWN)


def test_a_member_that_has_diverged_counts() -> None:
    def diverged(nan: float) -> list[bytes]:
        states = [State.decode(data) for data in ROWS[0]]
        speed = np.array([1.0, nan])
        return [replace(state, speed=speed, position=speed).encode() for state in states]

    digests = []
    for nan in (np.nan, -np.nan, 2.0):
        digest = RowDigest(CONFIGURATION)
        digest.add(diverged(nan))
        digests.append(digest.text)
    assert digests[0] == digests[1] != digests[2]


def test_messages_in_any_order_within_a_row_have_the_same_digest() -> None:
    backwards = [(bird, ROWS[k][bird - 1]) for k in range(len(ROWS)) for bird in (2, 3, 1)]
    assert watched(MESSAGES).text == watched(backwards).text == of(FLOWN)


def test_a_row_that_lacks_a_state_is_left_out() -> None:
    assert watched(MESSAGES[:4] + MESSAGES[5:]).text == of([FLOWN[0], *FLOWN[2:]])
    assert watched(MESSAGES[:-1]).text == of(FLOWN[:-1])
    by_bird = sorted(MESSAGES, key=lambda message: message[0])
    assert watched(by_bird).text is None


def test_a_state_of_another_length_belongs_to_no_row() -> None:
    odd = State.at(CONFIGURATION, 0, *np.ones((6, 3))).encode()
    assert watched([(1, odd), *MESSAGES[1:]]).text == of(FLOWN[1:])
    digest = RowDigest(CONFIGURATION)
    digest.add([odd, *ROWS[0][1:]])
    assert digest.text is None


def test_a_bag_has_the_digest_of_its_states(tmp_path: Path) -> None:
    with BagReader(record(tmp_path / "bag", CONFIGURATION, run_id=7, grants=True)) as bag:
        assert digest_of(bag, CONFIGURATION).text == of(FLOWN)

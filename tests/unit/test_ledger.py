# SPDX-License-Identifier: Apache-2.0
"""Rows leave the ledger in order, each once and whole, however their messages came."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.ledger import Ledger, Row
from flock_sim.core.messages import Time
from flock_sim.core.monolith import Monolith
from flock_sim.core.runge_kutta import STAGES
from flock_sim.core.stage_message import HEADER, stage_bytes, stage_words
from flock_sim.reference import row

CONFIGURATION = FlockConfiguration(birds=3, t_max=11.0, record_every=4)
BIRDS = range(1, 4)
STEPS = (0, 4, 8)

Letter = tuple[str, int, bytes]


def stage(bird: int, step: int, number: int) -> bytes:
    import numpy as np

    data = stage_bytes(np.zeros(stage_words(1)), 1)
    HEADER.pack_into(data, 4, 7, step, 1, bird, number, 1)
    return bytes(data)


def letters(stages: bool) -> list[Letter]:
    """Everything that a flight sends to its recorder."""
    sent: list[Letter] = []
    for recorded in Monolith(CONFIGURATION).fly():
        of = row(CONFIGURATION, recorded)
        sent += [("wing", bird, data) for bird, data in enumerate(of.wings, start=1)]
        sent += [("state", bird, data) for bird, data in enumerate(of.states, start=1)]
        sent.append(("time", 0, of.time))
    if stages:
        ticks = [(step, number) for step in range(11) for number in range(STAGES)]
        sent += [("stage", bird, stage(bird, *tick)) for tick in ticks for bird in BIRDS]
    return sent


def give(ledger: Ledger, letter: Letter) -> list[Row]:
    kind, bird, data = letter
    if kind == "time":
        return ledger.add_time(data)
    return {"wing": ledger.add_wing, "state": ledger.add_state, "stage": ledger.add_stage}[kind](
        bird, data
    )


def expected(stages: bool) -> list[Row]:
    sent = letters(stages)
    rows = []
    for number, recorded in enumerate(Monolith(CONFIGURATION).fly()):
        of = row(CONFIGURATION, recorded)
        ticks = range(STAGES * (recorded.step - 4), STAGES * recorded.step) if number else ()
        kept = [(b, stage(b, *divmod(tick, STAGES))) for tick in ticks for b in BIRDS]
        rows.append(Row(of.step, of.wings, kept if stages else [], of.time, of.states))
    assert len(sent) == 3 * 3 + 3 + 3 + (11 * STAGES * 3 if stages else 0)
    return rows


@pytest.mark.parametrize("stages", [False, True])
@given(seed=st.integers(0, 2**32), again=st.integers(0, 40))
def test_rows_leave_in_order_whole_and_once_whatever_order_messages_come_in(
    stages: bool, seed: int, again: int
) -> None:
    random = Random(seed)
    sent = letters(stages)
    sent += random.choices(sent, k=again)
    random.shuffle(sent)
    ledger = Ledger(CONFIGURATION, stages)
    rows = [out for letter in sent for out in give(ledger, letter)]
    assert rows == expected(stages)
    assert ledger.complete
    assert ledger.saved == 8


@pytest.mark.parametrize("stages", [False, True])
def test_a_row_waits_for_the_last_of_its_messages(stages: bool) -> None:
    sent = letters(stages)
    due = [letter for letter in sent if letter[0] != "stage" or letter[2] in stages_due()]
    for held in due:
        ledger = Ledger(CONFIGURATION, stages)
        before = [out for letter in sent if letter is not held for out in give(ledger, letter)]
        assert len(before) < len(STEPS), held
        assert not ledger.complete
        after = give(ledger, held)
        assert before + after == expected(stages)
        assert ledger.complete


def stages_due() -> set[bytes]:
    """Stages of the steps that a recorded step follows: 8 to 11 has none."""
    return {stage(b, step, k) for b in BIRDS for step in range(8) for k in range(STAGES)}


def test_what_is_saved_is_the_last_row_that_left() -> None:
    ledger = Ledger(CONFIGURATION)
    assert (ledger.saved, ledger.waiting_for) == (-1, [1, 2, 3])
    saved = []
    for letter in letters(stages=False):
        give(ledger, letter)
        saved.append(ledger.saved)
    assert sorted(set(saved)) == [-1, 0, 4, 8]
    assert saved == sorted(saved)


def test_the_birds_that_are_waited_for_are_those_whose_state_or_wing_is_missing() -> None:
    ledger = Ledger(CONFIGURATION)
    sent = letters(stages=False)
    for letter in sent:
        if letter[:2] not in (("wing", 2), ("state", 3)):
            give(ledger, letter)
    assert ledger.waiting_for == [2, 3]


def test_what_is_not_due_is_counted_and_left_out() -> None:
    ledger = Ledger(CONFIGURATION)
    sent = letters(stages=False)
    rows = [out for letter in sent for out in give(ledger, letter)]
    assert ledger.ignored == 0
    for letter in sent:
        assert give(ledger, letter) == []
    assert ledger.ignored == 3 * 3 + 3  # wings are latched, and no news
    ledger.add_time(Time.at(CONFIGURATION.stamp(2)).encode())  # no recorded step
    ledger.add_time(Time.at(CONFIGURATION.stamp(4) + 1).encode())  # not its time to the ns
    assert ledger.ignored == 14
    assert rows == expected(stages=False)


def test_a_first_wing_is_not_replaced() -> None:
    ledger = Ledger(CONFIGURATION)
    for bird in BIRDS:
        ledger.add_wing(bird, b"first")
        ledger.add_wing(bird, b"second")
    rows = [out for k in letters(stages=False) if k[0] != "wing" for out in give(ledger, k)]
    assert rows[0].wings == [b"first"] * 3


def test_memory_does_not_grow_with_the_flight() -> None:
    configuration = FlockConfiguration(birds=3, t_max=2000.0, record_every=1)
    ledger = Ledger(configuration)
    for recorded in Monolith(configuration).fly():
        of = row(configuration, recorded)
        for bird in BIRDS:
            if of.wings:
                ledger.add_wing(bird, of.wings[bird - 1])
            ledger.add_state(bird, of.states[bird - 1])
        assert len(ledger.add_time(of.time)) == 1
        assert len(ledger._rows) <= 1


def test_a_first_state_is_not_replaced_while_its_row_is_incomplete() -> None:
    ledger = Ledger(CONFIGURATION)
    sent = letters(stages=False)
    states = [data for kind, bird, data in sent if (kind, bird) == ("state", 1)]
    ledger.add_state(1, states[0])
    other = bytearray(states[0])
    other[-1] ^= 1
    assert ledger.add_state(1, bytes(other)) == []
    assert ledger.ignored == 1
    rows = [out for letter in sent for out in give(ledger, letter)]
    assert rows == expected(stages=False)

# SPDX-License-Identifier: Apache-2.0
"""The assembler emits whole rows in order, each once, for any order of messages."""

from __future__ import annotations

import struct
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.reference_flight import row
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE, MISSHAPEN, REPEATED, STALE
from flock_sim.messages.stage_layout import HEADER, stage_bytes, stage_words
from flock_sim.messages.topics import rows_ahead
from flock_sim.messages.types import Memory, State, Time, Wing
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.recording.row_assembler import MOST_AHEAD, Row, RowAssembler
from flock_sim.reference.integrator import Reference

CONFIGURATION = FlockConfiguration(birds=3, t_max=11.0, record_every=4)
BIRDS = range(1, 4)
STEPS = (0, 4, 8)
RUN, EPOCH = 7, 3

Letter = tuple[str, int, bytes]


def stage(bird: int, step: int, number: int) -> bytes:
    data = stage_bytes(np.zeros(stage_words(1)), 1)
    HEADER.pack_into(data, 4, RUN, step, EPOCH, bird, number, 1)
    return bytes(data)


def sent_in(state: bytes, run_id: int, epoch: int) -> bytes:
    """A state of a bag as it travelled in a run."""
    return replace(State.decode(state), run_id=run_id, epoch=epoch).encode()


def faster(state: bytes) -> bytes:
    """The state of another flight, at the same step."""
    decoded = State.decode(state)
    return replace(decoded, speed=decoded.speed + 1.0).encode()


def new_ledger(stages: bool = False, saved: int = -1) -> RowAssembler:
    assembler = RowAssembler(CONFIGURATION, stages, saved)
    assembler.begin(RUN, EPOCH)
    return assembler


def letters(stages: bool) -> list[Letter]:
    """Everything that a flight sends to its recorder."""
    sent: list[Letter] = []
    for recorded in Reference(CONFIGURATION).fly():
        of = row(CONFIGURATION, recorded)
        sent += [("wing", bird, data) for bird, data in enumerate(of.wings, start=1)]
        sent += [
            ("state", bird, sent_in(data, RUN, EPOCH))
            for bird, data in enumerate(of.states, start=1)
        ]
        sent.append(("time", 0, of.time))
    if stages:
        ticks = [(step, number) for step in range(11) for number in range(STAGES)]
        sent += [("stage", bird, stage(bird, *tick)) for tick in ticks for bird in BIRDS]
    return sent


def give(assembler: RowAssembler, letter: Letter) -> list[Row]:
    kind, bird, data = letter
    if kind == "time":
        return assembler.add_time(data)
    return {"wing": assembler.add_wing, "state": assembler.add_state, "stage": assembler.add_stage}[
        kind
    ](bird, data)


def expected(stages: bool) -> list[Row]:
    sent = letters(stages)
    rows = []
    for number, recorded in enumerate(Reference(CONFIGURATION).fly()):
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
    assembler = new_ledger(stages)
    rows = [out for letter in sent for out in give(assembler, letter)]
    assert rows == expected(stages)
    assert assembler.complete
    assert assembler.saved == 8


@pytest.mark.parametrize("stages", [False, True])
def test_a_row_waits_for_the_last_of_its_messages(stages: bool) -> None:
    sent = letters(stages)
    due = [letter for letter in sent if letter[0] != "stage" or letter[2] in stages_due()]
    for held in due:
        assembler = new_ledger(stages)
        before = [out for letter in sent if letter is not held for out in give(assembler, letter)]
        assert len(before) < len(STEPS), held
        assert not assembler.complete
        after = give(assembler, held)
        assert before + after == expected(stages)
        assert assembler.complete


def stages_due() -> set[bytes]:
    """Stages of the steps that a recorded step follows: 8 to 11 has none."""
    return {stage(b, step, k) for b in BIRDS for step in range(8) for k in range(STAGES)}


def test_what_is_saved_is_the_last_row_that_left() -> None:
    assembler = new_ledger()
    assert (assembler.saved, assembler.waiting_for) == (-1, [1, 2, 3])
    saved = []
    for letter in letters(stages=False):
        give(assembler, letter)
        saved.append(assembler.saved)
    assert sorted(set(saved)) == [-1, 0, 4, 8]
    assert saved == sorted(saved)


def test_the_birds_that_are_waited_for_are_those_whose_state_or_wing_is_missing() -> None:
    assembler = new_ledger()
    sent = letters(stages=False)
    for letter in sent:
        if letter[:2] not in (("wing", 2), ("state", 3)):
            give(assembler, letter)
    assert assembler.waiting_for == [2, 3]


def test_what_is_not_due_is_left_out_and_counted_if_it_has_a_run() -> None:
    assembler = new_ledger()
    sent = letters(stages=False)
    rows = [out for letter in sent for out in give(assembler, letter)]
    assert assembler.ignored == 0
    for letter in sent:
        assert give(assembler, letter) == []
    assert assembler.ignored == 3 * 3  # wings are latched, and /clock has no run
    assembler.add_time(Time.at(CONFIGURATION.stamp(2)).encode())  # no recorded step
    assembler.add_time(Time.at(CONFIGURATION.stamp(4) + 1).encode())  # not its time to the ns
    assert assembler.ignored == 9
    assert rows == expected(stages=False)


def test_a_first_wing_is_not_replaced() -> None:
    assembler = new_ledger()
    wings = {bird: Wing(RUN, bird, np.ones(1)) for bird in BIRDS}
    for bird, wing in wings.items():
        assembler.add_wing(bird, wing.encode())
        assembler.add_wing(bird, replace(wing, span_ratio=np.full(1, 0.9)).encode())
    rows = [out for k in letters(stages=False) if k[0] != "wing" for out in give(assembler, k)]
    assert rows[0].wings == [wing.encode() for wing in wings.values()]


def test_bytes_after_a_message_are_not_recorded() -> None:
    assembler = new_ledger()
    kinds = ("wing", "time")
    sent = [(k, b, data + b"more" if k in kinds else data) for k, b, data in letters(stages=False)]
    assert [out for letter in sent for out in give(assembler, letter)] == expected(stages=False)


@pytest.mark.parametrize(
    "forged",
    [
        stage(2, 0, 0),  # on the topic of bird 1
        stage(1, 0, 4),
        stage(1, 0, 255),
        b"\0\0" + stage(1, 0, 0)[2:],
        stage(1, 0, 0)[:-1],
        stage(1, 0, 0) + bytes(8),
        stage(1, 0, 0)[:44] + b"\xff" + stage(1, 0, 0)[45:],  # length of the speeds
    ],
)
def test_an_impossible_stage_completes_no_row(forged: bytes) -> None:
    assembler = new_ledger(stages=True)
    assembler.add_stage(1, forged)
    assert assembler.ignored == 1
    rows = [out for letter in letters(stages=True) for out in give(assembler, letter)]
    assert rows == expected(stages=True)


def test_a_state_with_the_time_of_another_step_is_ignored() -> None:
    assembler = new_ledger()
    for letter in letters(stages=False):
        if letter[0] == "state":
            state = State.decode(letter[2])
            for time in (state.time + 1.0, np.nan, 1e300):
                assert give(assembler, (*letter[:2], replace(state, time=time).encode())) == []
    assert assembler.ignored_for == {IMPOSSIBLE: 27}


def test_rows_far_ahead_are_not_kept() -> None:
    flown = FlockConfiguration(birds=1, t_max=1e6, record_every=1)
    assembler = RowAssembler(flown)
    assembler.begin(RUN, EPOCH)
    for step in range(20_000):
        assembler.add_time(Time.at(flown.stamp(step)).encode())
    assert len(assembler._rows) <= MOST_AHEAD * rows_ahead(flown) + 1
    state = State.at(flown, 20_000, *np.ones((6, 1)), run_id=RUN, epoch=EPOCH)
    assert assembler.add_state(1, state.encode()) == []
    assert assembler.ignored_for == {REPEATED: 1}


def test_memory_does_not_grow_with_the_flight() -> None:
    configuration = FlockConfiguration(birds=3, t_max=2000.0, record_every=1)
    assembler = RowAssembler(configuration)
    assembler.begin(RUN, EPOCH)
    for recorded in Reference(configuration).fly():
        of = row(configuration, recorded)
        for bird in BIRDS:
            if of.wings:
                assembler.add_wing(bird, of.wings[bird - 1])
            assembler.add_state(bird, sent_in(of.states[bird - 1], RUN, EPOCH))
        assert len(assembler.add_time(of.time)) == 1
        assert len(assembler._rows) <= 1


def test_a_first_state_is_not_replaced_while_its_row_is_incomplete() -> None:
    assembler = new_ledger()
    sent = letters(stages=False)
    states = [data for kind, bird, data in sent if (kind, bird) == ("state", 1)]
    assembler.add_state(1, states[0])
    other = bytearray(states[0])
    other[-40] ^= 1  # a digit, and neither run nor epoch
    assert assembler.add_state(1, bytes(other)) == []
    assert assembler.ignored == 1
    rows = [out for letter in sent for out in give(assembler, letter)]
    assert rows == expected(stages=False)


@pytest.mark.parametrize("stages", [False, True])
@given(seed=st.integers(0, 2**32), cut=st.integers(0, 100), saved=st.booleans())
def test_a_new_epoch_takes_nothing_of_the_old_one(
    stages: bool, seed: int, cut: int, saved: bool
) -> None:
    # Whatever had come of the rows that are not complete comes again, and only that counts: the
    # new epoch may begin with a push, after which states differ.
    random = Random(seed)
    assembler = new_ledger(stages)
    sent = [
        (kind, bird, faster(data) if kind == "state" else data)
        for kind, bird, data in letters(stages)
    ]
    random.shuffle(sent)
    rows = [out for letter in sent[:cut] for out in give(assembler, letter)]
    old = [letter for letter in sent if letter[0] in ("state", "stage")]
    if saved and rows:  # the recorder died too: what had left the assembler is on disk
        assembler = RowAssembler(CONFIGURATION, stages, rows[-1].step)
    assembler.begin(RUN, EPOCH + 1)
    for letter in random.sample(old, k=min(5, len(old))):
        assert give(assembler, letter) == []
    assert assembler.ignored_for[STALE] == min(5, len(old))
    new = []
    for kind, bird, data in letters(stages):
        fresh = bytearray(data)
        if kind == "state":
            struct.pack_into("<I", fresh, len(data) - 4, EPOCH + 1)
        elif kind == "stage":
            struct.pack_into("<I", fresh, 20, EPOCH + 1)
        new.append((kind, bird, bytes(fresh)))
    random.shuffle(new)
    begun = len(rows)
    rows += [out for letter in new for out in give(assembler, letter)]
    due = expected(stages)
    assert [(row.step, row.time) for row in rows] == [(row.step, row.time) for row in due]
    old_states = [[*map(faster, row.states)] for row in due[:begun]]
    assert [row.states for row in rows] == old_states + [row.states for row in due[begun:]]
    assert rows[0].wings == expected(stages)[0].wings
    assert assembler.complete


def test_a_row_is_of_one_run_and_epoch_and_says_so_no_more() -> None:
    assembler = new_ledger()
    (state,) = [k[2] for k in letters(stages=False) if k[:2] == ("state", 1)][:1]
    for run_id, epoch in ((RUN + 1, EPOCH), (0, 0), (RUN, EPOCH - 1), (RUN, EPOCH + 1)):
        assert assembler.add_state(1, sent_in(state, run_id, epoch)) == []
    assert assembler.ignored_for == {FOREIGN: 2, STALE: 2}
    assert assembler.add_state(1, state[:-1]) == assembler.add_state(1, state + b"0") == []
    assert assembler.ignored_for[MISSHAPEN] == 2
    assert assembler.waiting_for == [1, 2, 3]


def test_a_run_that_is_stopped_has_no_rows_beyond() -> None:
    assembler = new_ledger()
    assembler.end_at(7)
    rows = [out for letter in letters(stages=False) for out in give(assembler, letter)]
    assert rows == expected(stages=False)[:2]
    assert assembler.complete


def test_a_row_is_complete_with_the_memories_of_those_who_have_one() -> None:
    linked = replace(CONFIGURATION, links=("2->3=hold:delay=1",))
    assembler = RowAssembler(linked)
    assembler.begin(RUN, EPOCH)
    for letter in letters(stages=False):
        assert give(assembler, letter) == []
    assert assembler.waiting_for == [3]

    def memory(step: int, run_id: int = RUN, epoch: int = EPOCH, more: int = 0) -> bytes:
        data = np.zeros(linked.link_table.remembers(3) + more)
        return Memory(run_id, step, epoch, 3, data).encode()

    for wrong, reason in (
        (memory(0, run_id=RUN + 1), FOREIGN),
        (memory(0, epoch=EPOCH - 1), STALE),
        (memory(0, more=1), MISSHAPEN),
        (memory(1), REPEATED),
    ):
        before = assembler.ignored_for[reason]
        assert assembler.add_memory(3, wrong) == []
        assert assembler.ignored_for[reason] == before + 1
    rows = [row for step in STEPS for row in assembler.add_memory(3, memory(step))]
    assert [row.step for row in rows] == list(STEPS)
    assert [row.memories for row in rows] == [[memory(step)] for step in STEPS]
    assert assembler.complete


def test_a_state_whose_arrays_have_other_lengths_is_left_out() -> None:
    flock = FlockConfiguration(birds=1, t_max=1.0, record_every=1, span_ratios=("1=1.0,1.0",))
    assembler = RowAssembler(flock)
    assembler.begin(7, 1)
    arrays = [np.ones(length) for length in (1, 3, 2, 2, 2, 2)]  # as long as six of two in all
    wrong = State.at(flock, 0, *arrays, run_id=7, epoch=1).encode()
    assert len(wrong) == State.lengths(2).size
    assert assembler.add_state(1, wrong) == []
    assert assembler.ignored_for == {MISSHAPEN: 1}


def test_a_state_of_another_program_may_have_no_means() -> None:
    """Its serialiser may add bytes. The row has the state as Flock encodes it."""
    assembler = new_ledger()
    sent = letters(stages=False)
    rows = []
    for kind, bird, data in sent:
        if kind == "state" and bird == 2:
            state = State.decode(data)
            none = np.empty(0)
            data = replace(state, mean_speed=none, mean_interaction_drag=none).encode() + bytes(8)
        rows += give(assembler, (kind, bird, data))
    assert len(rows) == len(expected(stages=False))
    for found, whole in zip(rows, expected(stages=False), strict=True):
        assert found.states[::2] == whole.states[::2]
        state = State.decode(found.states[1])
        assert len(state.mean_speed) == len(state.mean_interaction_drag) == 0
        assert np.array_equal(state.position, State.decode(whole.states[1]).position)
        assert (state.run_id, state.epoch) == (0, 0)
    assert assembler.complete

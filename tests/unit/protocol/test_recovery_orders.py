# SPDX-License-Identifier: Apache-2.0
"""Orders of messages and of kills that are difficult for the recovery, one by one."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.epochs import CLOCKS, REACH
from flock_sim.messages.handshake import check_handshake, handshake, run_id_of
from flock_sim.messages.topics import RECORDER, bird_name
from flock_sim.messages.types import Checkpoint, Grant, Progress, Stage, State, Wing
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.clock import Timekeeper
from flock_sim.protocol.session import Channel, Outgoing
from flock_sim.recording.row_assembler import RowAssembler
from flock_sim.reference.integrator import Reference
from support.simulator.recorder import RUN
from support.simulator.world import CLOCK, FORGER, World

TWO = FlockConfiguration(birds=2, t_max=8.0, record_every=1)


def grant(step: int, epoch: int, **changes: object) -> Grant:
    return replace(Grant(RUN, step, TWO.steps, TWO.dt, epoch, handshake(TWO)), **changes)


def flown(step: int) -> Reference:
    flock = Reference(TWO)
    flock.advance(step)
    return flock


def checkpoint(step: int, epoch: int) -> Checkpoint:
    """The checkpoint that a recorder sends that has all up to `step` on disk."""
    flock = flown(step)
    return Checkpoint(RUN, step, epoch, flock.position.ravel(), flock.speed.ravel())


def ticks(out: list[Outgoing]) -> list[tuple[int, int, int]]:
    """Epoch, step and stage of the stages in `out`."""
    stages = [Stage.decode(data) for channel, data in out if channel is Channel.STAGE]
    return [(stage.epoch, stage.step, stage.stage) for stage in stages]


def bird_one() -> BirdProtocol:
    """Bird 1 of two in epoch 1, at its first stage."""
    bird = BirdProtocol(1, TWO)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_checkpoint(Checkpoint.of_start(RUN, 1))
    assert ticks(bird.receive_grant(grant(0, 1))) == [(1, 0, 0)]
    assert bird.receive_grant(grant(8, 1)) == []
    return bird


def first_stage(bird: int, step: int, epoch: int) -> bytes:
    """What a bird says first in an epoch that begins at `step`."""
    other = BirdProtocol(bird, TWO)
    other.receive_wing(Wing(RUN, 3 - bird, np.ones(1)))
    other.receive_grant(grant(0, epoch))
    ((_, data),) = other.receive_checkpoint(checkpoint(step, epoch))
    return data


# --- one bird ---


def test_an_epoch_begins_where_its_checkpoint_says_and_with_the_same_bits() -> None:
    bird = bird_one()
    bird.receive_grant(grant(0, 2))
    out = bird.receive_checkpoint(checkpoint(5, 2))
    assert ticks(out) == [(2, 5, 0)]
    out = bird.receive_stage(first_stage(2, 5, 2)) + bird.receive_grant(grant(8, 2))
    assert [channel for channel, _ in out].count(Channel.STATE) == 0  # that of step 5 is on disk
    (stage,) = [Stage.decode(data) for channel, data in out if channel is Channel.STAGE]
    assert (stage.step, stage.stage) == (5, 1)


def test_a_checkpoint_may_overtake_its_grant() -> None:
    bird = bird_one()
    assert bird.receive_checkpoint(checkpoint(5, 2)) == []
    assert ticks(bird.receive_grant(grant(0, 2))) == [(2, 5, 0)]


def test_a_bird_that_is_epochs_behind_goes_to_the_last_one_and_nowhere_else() -> None:
    bird = bird_one()
    assert ticks(bird.receive_checkpoint(checkpoint(2, 2))) == []
    assert ticks(bird.receive_checkpoint(checkpoint(6, 4))) == []
    assert ticks(bird.receive_grant(grant(3, 3))) == []
    # A checkpoint of a later epoch is no reason to leave this one out: anybody may send one.
    assert ticks(bird.receive_checkpoint(checkpoint(3, 3))) == [(3, 3, 0)]
    assert ticks(bird.receive_grant(grant(0, 4))) == [(4, 6, 0)]
    before = bird.ignored
    for late in (lambda: bird.receive_grant(grant(8, 3)),
                 lambda: bird.receive_checkpoint(checkpoint(3, 3)),
                 lambda: bird.receive_checkpoint(checkpoint(2, 2)),
                 lambda: bird.receive_stage(first_stage(2, 3, 3))):  # fmt: skip
        assert late() == []
    assert bird.ignored == before + 4
    assert (bird.step, bird.missing) == (6, [2])


def test_a_stage_of_the_next_epoch_waits_while_the_bird_flies_in_this_one() -> None:
    bird = bird_one()
    assert bird.receive_stage(first_stage(2, 5, 2)) == []
    assert ticks(bird.receive_stage(first_stage(2, 0, 1))) == [(1, 0, 1)]
    bird.receive_grant(grant(0, 2))
    out = bird.receive_checkpoint(checkpoint(5, 2))
    assert ticks(out) == [(2, 5, 0)]
    assert bird.missing == []
    assert [Progress.decode(d).step for c, d in out if c is Channel.PROGRESS] == [5]


def test_what_was_heard_in_an_epoch_counts_in_no_other() -> None:
    bird = bird_one()
    bird.receive_stage(first_stage(2, 0, 1))
    bird.receive_grant(grant(0, 2))
    assert ticks(bird.receive_checkpoint(Checkpoint.of_start(RUN, 2))) == [(2, 0, 0)]
    bird.receive_grant(grant(8, 2))
    assert bird.missing == [2]
    assert bird.receive_stage(first_stage(2, 0, 1)) == []
    assert ticks(bird.receive_stage(first_stage(2, 0, 2))) == [(2, 0, 1)]


@pytest.mark.parametrize(
    "impossible",
    [
        replace(checkpoint(5, 2), step=9),
        replace(checkpoint(5, 2), speed=np.ones(1)),
        replace(checkpoint(5, 2), position=np.ones(3), speed=np.ones(3)),
        replace(Checkpoint.of_start(RUN, 2), step=1),
    ],
    ids=["beyond the end", "half of it", "three birds", "a start at step 1"],
)
def test_a_checkpoint_that_cannot_be_is_counted_and_the_true_one_taken(
    impossible: Checkpoint,
) -> None:
    bird = bird_one()
    bird.receive_grant(grant(0, 2))
    assert bird.receive_checkpoint(impossible) == []
    assert bird.ignored == 1
    assert ticks(bird.receive_checkpoint(checkpoint(5, 2))) == [(2, 5, 0)]


@pytest.mark.parametrize("epoch", [1, 2, 2**31])
def test_the_checkpoint_of_another_flock_begins_nothing_and_keeps_nothing_out(epoch: int) -> None:
    # A bird that was told no run hears it before the first grant.
    bird = BirdProtocol(1, TWO)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_checkpoint(replace(checkpoint(5, epoch), run_id=RUN + 1))
    assert ticks(bird.receive_grant(grant(0, 2))) == []
    assert ticks(bird.receive_checkpoint(checkpoint(3, 2))) == [(2, 3, 0)]


@pytest.mark.parametrize("epoch", [1, 2, 2**31])
def test_a_checkpoint_that_came_before_another_flocks_is_not_forgotten(epoch: int) -> None:
    bird = BirdProtocol(1, TWO)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_checkpoint(checkpoint(3, 2))
    bird.receive_checkpoint(replace(checkpoint(5, epoch), run_id=RUN + 1))
    assert ticks(bird.receive_grant(grant(0, 2))) == [(2, 3, 0)]


def test_epochs_beyond_belief_are_counted() -> None:
    bird = bird_one()
    assert bird.receive_grant(grant(0, 2 + REACH)) == []
    assert bird.ignored == 1
    assert bird.receive_grant(grant(0, 1 + REACH)) != []


def test_a_bird_whose_epoch_was_begun_without_it_asks_for_another_one() -> None:
    keeper, bird = clock(), BirdProtocol(1, TWO, incarnation=1)
    gather(keeper, 0, -1)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_grant(keeper.grant)
    bird.receive_grant(grant(8, keeper.epoch))  # forged, before the bird has begun the epoch
    assert ticks(bird.receive_checkpoint(checkpoint(5, keeper.epoch))) == []
    for _, data in bird.report():
        keeper.receive(Progress.decode(data))
    assert keeper.epoch == 2
    bird.receive_checkpoint(checkpoint(5, 2))
    assert ticks(bird.receive_grant(keeper.grant)) == [(2, 5, 0)]


def test_a_second_process_of_a_bird_that_is_always_later_asks_ever_more_rarely() -> None:
    twin = BirdProtocol(1, TWO, incarnation=1)
    twin.receive_wing(Wing(RUN, 2, np.ones(1)))
    asked = set()
    for epoch in range(2, 102):  # in each, the first process reports, and the clock grants
        twin.receive_grant(grant(0, epoch))
        twin.receive_grant(grant(8, epoch))
        twin.receive_checkpoint(checkpoint(5, epoch))
        asked |= {Progress.decode(data).life for _, data in twin.report()}
    assert len(asked) == 7  # 1, 2, 4 ... 64


def test_forged_checkpoints_do_not_keep_out_the_true_one() -> None:
    bird = BirdProtocol(1, TWO)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_grant(grant(0, 2))
    for epoch in range(3, 40):
        bird.receive_checkpoint(checkpoint(5, epoch))
    assert ticks(bird.receive_checkpoint(checkpoint(5, 2))) == [(2, 5, 0)]


def test_an_epoch_beyond_belief_is_joined_when_it_is_said_again() -> None:
    bird = bird_one()
    assert bird.receive_checkpoint(checkpoint(5, 2 + REACH)) == []
    assert bird.receive_grant(grant(0, 2 + REACH)) == []
    assert ticks(bird.receive_grant(grant(0, 2 + REACH))) == [(2 + REACH, 5, 0)]


@pytest.mark.parametrize(
    "ahead", [2, REACH - 1, REACH, REACH + 1, 2**30, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - REACH - 1]
)
def test_a_clock_and_a_bird_come_together_wherever_one_message_has_sent_one(ahead: int) -> None:
    keeper, bird = clock(), bird_one()
    gather(keeper, 0, -1)
    for forged in (lambda: bird.receive_grant(grant(0, 1 + ahead)),
                   lambda: tell(keeper, 0, "bird_02", epoch=1 + ahead)):  # fmt: skip
        forged()
        for _ in range(4):  # what both say every second
            for channel, data in bird.report():
                if channel is Channel.PROGRESS:
                    keeper.receive(Progress.decode(data))
            bird.receive_grant(keeper.grant)
        assert bird._session.epoch == keeper.epoch


# --- the clock ---


def clock(window: int = 4, record: bool = True, epoch: int = 1) -> Timekeeper:
    return Timekeeper(TWO, RUN, window, record, epoch=epoch)


def tell(keeper: Timekeeper, step: int, who: str, life: int = 1, epoch: int | None = None) -> list:
    return keeper.receive(
        Progress(RUN, step, keeper.epoch if epoch is None else epoch, who, life)
    )  # fmt: skip


def gather(keeper: Timekeeper, step: int, saved: int) -> list:
    """Let all be there, the birds at `step`; return what the clock says last."""
    tell(keeper, saved, RECORDER)
    tell(keeper, step, "bird_01")
    return tell(keeper, step, "bird_02")


@pytest.mark.parametrize("who", ["bird_01", "bird_02", RECORDER])
def test_a_new_life_begins_an_epoch_and_an_old_one_none(who: str) -> None:
    keeper = clock()
    gather(keeper, 0, -1)
    grant, *rest = tell(keeper, -1, who, life=2)
    assert (grant.epoch, grant.step, rest) == (2, 0, [])
    assert tell(keeper, -1, who, life=1, epoch=1) == []  # its former life, still on its way
    assert tell(keeper, -1, who, life=2) == []
    assert (keeper.epoch, keeper.rewinds.count) == (2, 1)


def test_the_first_life_of_each_begins_no_epoch() -> None:
    keeper = clock()
    gather(keeper, 0, -1)
    assert keeper.rewinds.count == 0


def test_a_clock_goes_beyond_the_epochs_that_it_hears_of() -> None:
    keeper = clock(epoch=5)
    (grant,) = tell(keeper, 3, "bird_01", epoch=9)
    assert (grant.epoch, grant.step) == (begun := 5 + CLOCKS, 0)
    assert tell(keeper, 3, "bird_01", epoch=9) == []
    assert tell(keeper, 3, "bird_02", epoch=9) == []
    assert keeper.epoch == begun
    gather(keeper, 3, 3)
    assert tell(keeper, 3, "bird_02", epoch=begun + 1 + REACH) == []
    assert keeper.epoch == begun
    assert tell(keeper, 3, "bird_02", epoch=begun + REACH) != []
    assert keeper.epoch == begun + CLOCKS + REACH


@pytest.mark.parametrize("first", [1, 6, 7, CLOCKS, REACH])
def test_a_clock_begins_no_epoch_of_the_clock_before_it(first: int) -> None:
    # Birds keep their reports of some time for a new clock, and it hears the oldest ones first.
    before = clock(epoch=first + CLOCKS // 2 + 1)
    keeper = clock(epoch=first)
    for _ in range(9):
        tell(keeper, 3, "bird_01", epoch=before.epoch)
        before.rewind()
    assert before.epoch < keeper.epoch
    assert keeper.rewinds.count == 1


def test_leave_begins_anew_at_what_is_on_disk() -> None:
    keeper = clock(window=4)
    gather(keeper, 0, -1)
    keeper.rewind()
    said = gather(keeper, 3, 3)
    assert [message.step for message in said if isinstance(message, Grant)] == [7]


def test_a_run_that_is_stopped_ends_there_whoever_dies_afterwards() -> None:
    keeper = clock(window=4)
    gather(keeper, 0, -1)
    assert [(end.step, end.end) for end in keeper.stop()] == 2 * [(4, 4)]
    (again,) = tell(keeper, -1, "bird_01", life=2)
    assert again.end == 4
    gather(keeper, 2, 2)
    assert keeper.grant.step == 4
    gather(keeper, 4, 4)
    assert keeper.finished


def test_a_run_that_is_stopped_during_a_rewind_ends_where_it_would_go_on() -> None:
    # Nobody's leave is known then, and nobody may be told to end before what is on disk.
    keeper = clock(window=4)
    gather(keeper, 0, -1)
    tell(keeper, 4, "bird_01")
    keeper.rewind()
    keeper.stop()
    said = gather(keeper, 3, 3)
    assert keeper.finished
    assert [(m.step, m.end) for m in said if isinstance(m, Grant)] == 2 * [(3, 3)]


def test_steps_can_be_taken_one_by_one_after_a_pause_during_a_rewind() -> None:
    keeper = clock(window=4)
    gather(keeper, 0, -1)
    keeper.rewind()
    keeper.pause()
    gather(keeper, 3, 3)
    assert keeper.grant.step == 4, "where leave had ended"
    assert [message.step for message in keeper.take_steps(2)] == [6]


def test_a_pause_outlives_a_rewind() -> None:
    keeper = clock(window=4)
    gather(keeper, 0, -1)
    keeper.pause()
    tell(keeper, -1, "bird_01", life=2)
    gather(keeper, 1, 1)
    assert keeper.grant.step == 4
    gather(keeper, 4, 4)
    assert keeper.grant.step == 4
    assert keeper.paused
    assert [message.step for message in keeper.resume()] == [8]


# --- the recorder's assembler ---


def test_a_new_clock_that_knows_of_no_stop_flies_on_to_the_end() -> None:
    assembler = RowAssembler(TWO)
    assembler.begin(RUN, 1)
    assembler.end_at(4)
    assembler.begin(RUN, 2)
    assembler.end_at(TWO.steps)
    (data,) = [s for s in states(8) if State.step_of(s) == 8]
    assert assembler.add_state(1, replace(State.decode(data), run_id=RUN, epoch=2).encode()) == []
    assert assembler.ignored == 0
    assert not assembler.complete


def states(step: int) -> Iterator[bytes]:
    one = np.ones(1)
    yield State.at(TWO, step, *6 * [one]).encode()


# --- whole flights ---


def world(record: bool = True, seed: int = 0, **flight: float) -> World:
    configuration = FlockConfiguration(**{"birds": 3, "t_max": 12.0, "record_every": 2, **flight})
    made = World(configuration, 4, Random(seed), record=record)
    made.bring(*made.everybody)
    return made


def fly_until(flight: World, condition: Callable[[], bool]) -> None:
    for _ in range(100_000):
        if condition():
            return
        flight.deliver_some(1)
        flight.flush()
    raise AssertionError(flight.why_it_stands_still())


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("victims", [(), (CLOCK,), ("bird_02",), (CLOCK, "bird_02", RECORDER)])
def test_a_stop_and_a_death_end_in_a_flight_that_is_whole(
    victims: tuple[str, ...], seed: int
) -> None:
    flight = world(seed=seed)
    fly_until(flight, lambda: flight.keeper.step >= 3)
    flight.stop()
    flight.deliver_some(5 * seed)
    flight.kill(*victims)
    flight.settle()


@pytest.mark.parametrize("seed", range(10))
def test_a_pause_and_a_death_and_the_flight_goes_on(seed: int) -> None:
    flight = world(seed=seed)
    fly_until(flight, lambda: flight.keeper.step >= 3)
    flight.keeper.pause()
    flight.deliver_some(5 * seed)
    flight.kill("bird_01", RECORDER)
    flight.deliver_some(5 * seed)
    flight.bring("bird_01", RECORDER)
    while flight.deliverable():
        flight.deliver_some(10)
        flight.flush()
    assert not flight.over
    flight.resume()
    flight.settle()


@pytest.mark.parametrize("record", [True, False])
@pytest.mark.parametrize("seed", range(10))
def test_two_birds_of_one_number_are_one_to_all_others(seed: int, record: bool) -> None:
    # Somebody starts a bird a second time. All that both say is the same.
    flight = world(seed=seed, record=record)
    flight.deliver_some(20 * seed)
    flight.bring("bird_02")
    assert len(flight.twins) == 1
    flight.settle()


@pytest.mark.parametrize("seed", range(20))
def test_all_die_at_once_and_only_the_disk_remembers(seed: int) -> None:
    flight = world(seed=seed)
    for step in (2, 5, 7):
        fly_until(flight, lambda step=step: flight.keeper.step >= step)
        flight.kill(*flight.everybody)
        flight.bring(*flight.everybody)
    flight.settle()


@pytest.mark.parametrize("record", [True, False])
@pytest.mark.parametrize("seed", range(20))
def test_a_bird_dies_in_every_rewind_that_the_one_before_began(seed: int, record: bool) -> None:
    flight = world(seed=seed, record=record)
    fly_until(flight, lambda: flight.keeper.step >= 3)
    for k in range(12):
        epoch = flight.keeper.epoch
        flight.kill(bird_name(1 + k % 3))
        flight.bring(bird_name(1 + k % 3))
        fly_until(flight, lambda epoch=epoch: flight.keeper.epoch > epoch)
        flight.deliver_some(k)
    flight.settle()


@pytest.mark.parametrize("seed", range(60))
def test_birds_die_and_then_the_clock_before_it_knows(seed: int) -> None:
    flight = world(seed=seed, t_max=30.0)
    for step in (2, 4, 6):
        fly_until(flight, lambda step=step: flight.keeper.step >= step)
        flight.rewind()  # so that the first bird has reports of several epochs for a new clock
    fly_until(flight, lambda: flight.keeper.step >= 8)
    flight.kill("bird_02", "bird_03", CLOCK)
    flight.bring("bird_02", "bird_03", CLOCK)
    flight.settle()


@pytest.mark.parametrize("seed", range(20))
def test_the_clock_and_a_bird_die_together_at_the_very_end(seed: int) -> None:
    flight = world(seed=seed)
    fly_until(flight, lambda: flight.keeper.step >= 12)
    if not flight.over:
        flight.kill(CLOCK, "bird_03")
    flight.settle()


def test_a_push_is_flown_although_a_forged_grant_made_the_recorder_drop_it() -> None:
    flight = world(t_max=30.0)
    fly_until(flight, lambda: flight.keeper.step >= 3)
    before = flight.keeper.grant
    assert flight.push(2, 0, 0.1, 0.0)
    (queue,) = [q for q in flight.deliverable(RECORDER) if q.topic == topics.PERTURBATION_TOPIC]
    flight.deliver(queue)
    forged = replace(before, epoch=before.epoch + 5)
    flight.post_forged(topics.GRANT_TOPIC, forged.encode(), RECORDER)
    (queue,) = [q for q in flight.deliverable(RECORDER) if q.sender.who == FORGER]
    flight.deliver(queue)
    flight.settle()
    assert len(flight.disk.live) == 1


# --- terms ---


def test_the_same_terms_in_other_words_are_the_same() -> None:
    check_handshake(
        "bird_01", TWO, json.dumps(json.loads(handshake(TWO)), indent=2, sort_keys=True)
    )


@pytest.mark.parametrize("said", ["", "{", "[]", "1", "null", '"text"', "[" * 100_000, "{" * 9])
def test_what_are_no_terms_is_refused_with_value_error(said: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        check_handshake("bird_01", TWO, said)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"birds": 3}, "birds = 2 where the clock has 3"),
        ({"dt": 0.5}, "dt = 1.0 where the clock has 0.5"),
        ({"span_ratios": ("2=1.1",)}, "span_ratios"),
        ({"cruise_speed": 19.0}, "cruise_speed = 18.5 where the clock has 19.0"),
    ],
)
def test_terms_that_differ_are_named(change: dict[str, object], named: str) -> None:
    other = replace(TWO, **change)
    with pytest.raises(FlockError, match=named) as refused:
        check_handshake("the recorder", TWO, handshake(other))
    assert str(refused.value).startswith("the recorder has ")
    assert "\n" not in str(refused.value)
    assert run_id_of(other) != run_id_of(TWO)


def test_a_term_that_is_long_is_shown_in_part() -> None:
    long = ",".join(["1.01"] * 500)
    with pytest.raises(FlockError) as refused:
        check_handshake("bird_01", TWO, handshake(replace(TWO, span_ratios=(f"1={long}",))))
    assert len(str(refused.value)) < 300

# SPDX-License-Identifier: Apache-2.0
"""Messages of this stage, the next one or a later epoch are kept; all others are classified."""

import numpy as np
import pytest

from flock_sim.links.exchange_schedule import ExchangeSchedule
from flock_sim.messages.epochs import REACH
from flock_sim.messages.rejection import (
    AGAIN,
    FOREIGN,
    IMPOSSIBLE,
    MALFORMED,
    MISSHAPEN,
    REPEATED,
    STALE,
    STRANGE,
)
from flock_sim.messages.types import Stage
from flock_sim.protocol.stage_inbox import EARLY, StageInbox

RUN, EPOCH = 7, 3


def stage(bird: int, tick: int, epoch: int = EPOCH, run_id: int = RUN, speed: float = 1.0) -> bytes:
    one = np.ones(1)
    step, number = divmod(tick, 4)
    return Stage(run_id, step, epoch, bird, number, one, np.array([speed]), one).encode()


def inbox(tick: int | None = None) -> StageInbox:
    """The inbox of bird 2 between birds 1 and 3, open at `tick`, or waiting for EPOCH to begin."""
    made = StageInbox([1, 3], members=1)
    made.close(RUN, EPOCH)
    if tick is not None:
        made.open(tick)
    return made


@pytest.mark.parametrize("speed", [np.nan, np.inf, -np.inf])
def test_at_the_start_nobody_is_anywhere_but_at_a_number(speed: float) -> None:
    box = inbox(tick=0)
    assert box.take(stage(1, 0, speed=speed)) == IMPOSSIBLE
    assert box.take(stage(1, 0)) == ""
    assert box.lacking == [3]


@pytest.mark.parametrize("speed", [np.nan, np.inf])
def test_a_neighbour_a_stage_ahead_may_have_diverged_already(speed: float) -> None:
    # It is not sent again: a bird that refused it would wait for it for ever.
    box = inbox(tick=0)
    assert box.take(stage(1, 0)) == box.take(stage(1, 1, speed=speed)) == ""
    assert box.take(stage(3, 0)) == ""
    box.turn()
    assert box.lacking == [3]


def test_a_flight_that_diverged_is_gone_on_with() -> None:
    box = inbox(tick=40)
    assert box.take(stage(1, 40, speed=np.nan)) == box.take(stage(3, 40, speed=np.inf)) == ""
    assert box.complete


def test_what_no_bird_can_have_at_the_start_does_not_keep_out_what_comes() -> None:
    box = inbox()
    assert box.take(stage(1, 0, speed=np.nan)) == IMPOSSIBLE
    assert box.take(stage(1, 0)) == ""
    box.open(0)
    assert box.lacking == [3]


def broken(genuine: bytes) -> list[bytes]:
    """Malformed messages of the right size with the right header."""
    encapsulation = genuine[:1] + b"\0" + genuine[2:]
    lengths = [genuine[:at] + b"\xff" + genuine[at + 1 :] for at in (44, 60)]  # of later sequences
    return [encapsulation, *lengths]


@pytest.mark.parametrize("tick", [None, 40])
def test_a_malformed_stage_does_not_take_the_place_of_the_genuine_one(tick: int | None) -> None:
    box = inbox(tick)
    genuine = stage(1, 40)
    for malformed in broken(genuine):
        assert box.take(malformed) == MALFORMED
    assert box.take(genuine) == ""
    if tick is None:
        box.open(40)
    assert box.lacking == [3]


def test_a_stage_of_an_epoch_to_come_is_there_when_it_begins() -> None:
    box = inbox(tick=40)
    assert box.take(stage(1, 32, epoch=EPOCH + 1)) == ""
    assert box.lacking == [1, 3]
    box.close(RUN, EPOCH + 1)
    assert box.take(stage(3, 32, epoch=EPOCH + 1)) == ""
    box.open(32)
    assert box.lacking == []


def test_a_stage_that_overtakes_the_first_grant_is_there_when_its_epoch_begins() -> None:
    # A bird came back while the clock did: the clock does not know, and nobody says it again.
    box = StageInbox([1, 3], members=1)
    for run_id in (RUN + 1, RUN):
        assert box.take(stage(1, 32, run_id=run_id)) == ""
    box.close(RUN, EPOCH)
    box.open(32)
    assert box.lacking == [3]


def test_where_the_run_is_known_another_is_foreign_before_the_first_grant() -> None:
    box = StageInbox([1, 3], members=1, run_id=RUN)
    assert box.take(stage(1, 32, run_id=RUN + 1)) == FOREIGN
    assert box.take(stage(1, 32)) == ""


def test_what_one_neighbour_said_long_ago_does_not_push_out_what_another_just_said() -> None:
    # Bird 2 was suspended while the others began many epochs; bird 1's messages are read first.
    box = inbox(tick=40)
    news = EPOCH + 5 * EARLY
    for bird in (1, 3):
        for epoch in range(EPOCH + 1, news + 1):
            box.take(stage(bird, 32, epoch=epoch))
    box.close(RUN, news)
    box.open(32)
    assert box.lacking == []


def test_each_that_is_not_kept_has_its_reason() -> None:
    box = inbox(tick=40)
    assert box.take(stage(1, 40, run_id=RUN + 1)) == FOREIGN
    assert box.take(stage(1, 40, run_id=0)) == FOREIGN
    assert box.take(stage(2, 40)) == box.take(stage(4, 40)) == STRANGE
    assert (
        box.take(stage(1, 40)[:-1]) == box.take(stage(1, 40) + b"0") == box.take(b"") == MISSHAPEN
    )
    assert box.take(stage(1, 40, epoch=EPOCH - 1)) == STALE
    assert box.take(stage(1, 37)) == box.take(stage(1, 42)) == REPEATED
    assert box.take(stage(1, 41, epoch=EPOCH + 1)) == REPEATED  # an epoch begins with a step
    assert box.take(stage(1, 40, epoch=EPOCH + REACH + 1)) == REPEATED
    assert box.take(stage(1, 40, epoch=EPOCH + REACH)) == ""
    assert box.lacking == [1, 3]


def test_of_all_that_comes_early_only_so_much_is_kept_and_the_rest_counted() -> None:
    box = inbox(tick=40)
    told = [box.take(stage(1, 40, epoch=EPOCH + 1 + k)) for k in range(1000)]
    assert told == [""] * EARLY + [REPEATED] * (1000 - EARLY)
    assert sum(map(len, box._early.values())) == EARLY


def test_what_is_said_again_is_told_from_what_nobody_can_mean() -> None:
    box = inbox(tick=40)
    for tick in (40, 41):
        assert box.take(stage(1, tick)) == ""
        assert box.take(stage(1, tick)) == AGAIN
    assert box.lacking == [3]
    box.take(stage(3, 40))
    box.turn()
    box.take(stage(3, 41))
    box.turn()
    # Bird 1 may still wait for another's stage 41, and says 40 and 41 then.
    assert box.take(stage(1, 40)) == box.take(stage(1, 41)) == AGAIN
    assert box.take(stage(1, 39)) == box.take(stage(1, 44)) == REPEATED


def test_what_is_said_again_to_a_bird_that_has_not_begun_is_no_news() -> None:
    box = inbox(tick=40)
    assert box.take(stage(1, 40, epoch=EPOCH + 1)) == ""
    assert box.take(stage(1, 40, epoch=EPOCH + 1)) == AGAIN


def test_between_two_exchanges_nothing_is_lacking_and_the_next_one_is_taken() -> None:
    box = StageInbox([1, 3], 1, ExchangeSchedule(False, (3,)))
    box.close(RUN, EPOCH)
    box.open(0)
    assert box.lacking == [1, 3]
    assert box.take(stage(1, 0)) == box.take(stage(3, 0)) == ""
    assert [box.turn() for tick in range(1, 12)] == [False] * 11
    assert box.lacking == []
    assert box.take(stage(1, 4)) == REPEATED
    assert box.take(stage(1, 12)) == ""
    assert box.take(stage(1, 24)) == REPEATED
    before = box.side
    assert box.turn()
    assert box.side != before
    assert box.lacking == [3]


def test_an_epoch_that_begins_between_two_exchanges_takes_the_next_one_that_came_early() -> None:
    box = StageInbox([1, 3], 1, ExchangeSchedule(False, (3,)))
    box.close(RUN, EPOCH)
    assert box.take(stage(1, 12)) == ""
    box.open(8)
    assert box.lacking == []
    assert [box.turn() for tick in range(9, 13)] == [False, False, False, True]
    assert box.lacking == [3]


def test_what_is_said_again_is_known_by_the_exchange_whatever_tick_that_is_at() -> None:
    box = StageInbox(
        [1, 3], 1, ExchangeSchedule(False, (3, 5))
    )  # at ticks 0, 12, 20, 24, 36, 40, 48
    box.close(RUN, EPOCH)
    box.open(0)
    for tick in range(27):
        for bird in (1, 3):
            box.take(stage(bird, tick))
        box.turn()
    told = {tick: box.take(stage(1, tick)) for tick in range(50) if tick != 36}
    assert [tick for tick, reason in told.items() if reason == AGAIN] == [12, 20, 24]
    assert set(told.values()) == {AGAIN, REPEATED}
    assert box.take(stage(1, 36)) == ""
    assert box.take(stage(1, 36)) == AGAIN

# SPDX-License-Identifier: Apache-2.0
"""The clock grants at most its window, and at most what the recorder can still save."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages import topics
from flock_sim.messages.epochs import CLOCKS, REACH, ahead
from flock_sim.messages.handshake import handshake
from flock_sim.messages.rejection import STALE
from flock_sim.messages.types import Grant, Progress, Time
from flock_sim.protocol.attendance import MOST_INCARNATIONS, Attendance
from flock_sim.protocol.clock import ABSENT, Timekeeper, new_run_id

RUN = 7


def clock(window: int = 4, record: bool = False, **flight: float) -> Timekeeper:
    configuration = FlockConfiguration(**{"birds": 2, "t_max": 20.0, "record_every": 5, **flight})
    return Timekeeper(configuration, RUN, window, record)


def reach(keeper: Timekeeper, step: int, *who: str, epoch: int = 1) -> list[Grant | Time]:
    return [
        message for name in who for message in keeper.receive(Progress(RUN, step, epoch, name))
    ]  # fmt: skip


def granted(messages: list[Grant | Time]) -> list[int]:
    return [message.step for message in messages if isinstance(message, Grant)]


def told(keeper: Timekeeper, messages: list[Grant | Time]) -> list[int]:
    times = [message.stamp for message in messages if isinstance(message, Time)]
    stamps = {keeper._configuration.stamp(step): step for step in range(21)}
    return [stamps[time] for time in times]


BIRDS = ("bird_01", "bird_02")


def test_nobody_may_go_before_all_are_there() -> None:
    keeper = clock(record=True)
    assert keeper.first_messages == [Grant(RUN, 0, 20, 1.0, 1, handshake(keeper._configuration))]
    assert granted(reach(keeper, 0, "bird_01")) == []
    assert granted(reach(keeper, 0, "bird_02")) == []
    assert keeper.waiting_for == ["recorder"]
    assert keeper.where == "before the start"
    assert granted(reach(keeper, -1, "recorder")) == [4]


def test_leave_reaches_the_window_beyond_the_slowest_bird() -> None:
    keeper = clock(window=4)
    reach(keeper, 0, *BIRDS)
    assert granted(reach(keeper, 4, "bird_01")) == []
    assert keeper.waiting_for == ["bird_02"]
    assert granted(reach(keeper, 2, "bird_02")) == [6]
    assert granted(reach(keeper, 4, "bird_02")) == [8]


def test_a_window_of_one_is_lockstep() -> None:
    keeper = clock(window=1)
    for step in range(20):
        assert granted(reach(keeper, step, *BIRDS)) == [step + 1]


def test_leave_never_goes_beyond_the_end() -> None:
    keeper = clock(window=1000)
    assert granted(reach(keeper, 0, *BIRDS)) == [20]
    assert not keeper.finished
    assert granted(reach(keeper, 20, *BIRDS)) == []
    assert keeper.finished


def test_leave_goes_no_further_beyond_what_is_on_disk_than_queues_hold() -> None:
    configuration = FlockConfiguration(birds=2, t_max=1e6, record_every=5)
    ahead = topics.steps_ahead(configuration, record_stages=False)
    keeper = Timekeeper(configuration, RUN, 10**9, record=True)
    reach(keeper, 0, *BIRDS)
    assert granted(reach(keeper, -1, "recorder")) == [ahead]
    assert granted(reach(keeper, ahead, *BIRDS)) == []
    assert keeper.waiting_for == ["recorder"]
    assert granted(reach(keeper, 50, "recorder")) == [50 + ahead]


@pytest.mark.parametrize("record_stages", [False, True])
@pytest.mark.parametrize(("birds", "members"), [(1, 1), (13, 1), (13, 500), (1000, 1)])
@pytest.mark.parametrize("every", [1, 10])
def test_what_may_be_under_way_fits_the_queues(
    birds: int, members: int, every: int, record_stages: bool
) -> None:
    ratios = ",".join(["1.0"] * members)
    configuration = FlockConfiguration(
        birds=birds, record_every=every, span_ratios=(f"1={ratios}",)
    )
    ahead = topics.steps_ahead(configuration, record_stages)
    # From the last step on disk to the one granted, both ends included, and a report on its way.
    rows = ahead // every + 2
    assert rows <= topics.depth(topics.state_topic(1), configuration)
    assert rows <= topics.depth(topics.CLOCK_TOPIC, configuration)
    if record_stages:
        assert 4 * (ahead + 1) <= topics.depth(topics.stage_topic(1), configuration)
    assert ahead >= 1


def test_a_flight_is_over_when_its_last_record_is_on_disk() -> None:
    keeper = clock(window=64, record=True, t_max=18.0)
    reach(keeper, 0, *BIRDS, "recorder")
    reach(keeper, 18, *BIRDS)
    reach(keeper, 10, "recorder")
    assert not keeper.finished
    reach(keeper, 15, "recorder")  # 18 is not recorded
    assert keeper.finished


def test_the_time_of_every_recorded_step_is_told_once_and_in_order() -> None:
    keeper = clock(window=64)
    assert told(keeper, reach(keeper, 0, *BIRDS)) == [0]
    assert told(keeper, reach(keeper, 4, *BIRDS)) == []
    assert told(keeper, reach(keeper, 11, *BIRDS)) == [5, 10]
    assert told(keeper, reach(keeper, 11, *BIRDS)) == []
    assert told(keeper, reach(keeper, 20, *BIRDS)) == [15, 20]


def test_progress_of_another_run_an_older_epoch_or_a_stranger_changes_nothing() -> None:
    keeper = clock()
    before = keeper.moves
    assert keeper.receive(Progress(RUN + 1, 0, 1, "bird_01")) == []
    assert keeper.receive(Progress(RUN, 0, 0, "bird_01")) == []
    assert keeper.receive(Progress(RUN, 0, 1, "bird_03")) == []
    assert keeper.receive(Progress(RUN, 0, 1, "stranger")) == []
    assert keeper.moves == before
    assert keeper.step == ABSENT


@given(
    window=st.integers(1, 30),
    record=st.booleans(),
    every=st.integers(1, 9),
    seed=st.integers(0, 2**32),
)
def test_stale_and_repeated_progress_takes_nothing_back(
    window: int, record: bool, every: int, seed: int
) -> None:
    random = Random(seed)
    keeper = clock(window=window, record=record, record_every=every)
    who = [*BIRDS, *(["recorder"] if record else [])]
    last = 20 - 20 % every
    leave, reached, out = 0, dict.fromkeys(who, -1), []
    met: set[str] = set()
    for _ in range(2000):
        name = random.choice(who)
        if name == "recorder":
            step = min(min(reached[bird] for bird in BIRDS), last)
        else:
            step = random.randint(reached[name], leave) if reached[name] >= 0 else 0
        if random.random() < 0.3:  # an old message, or one that comes again
            step = random.randint(-1, step) if name == "recorder" else random.randint(0, step)
        if name not in met:  # with nothing on disk, as at the start of a flight
            met.add(name)
            step = -1
        messages = reach(keeper, step, name)
        out += messages
        reached[name] = max(reached[name], step)
        for grant in granted(messages):
            slowest = min(reached[bird] for bird in BIRDS)
            assert leave < grant <= min(20, slowest + window)
            leave = grant
        if keeper.finished:
            break
    assert keeper.finished
    assert told(keeper, out) == list(range(0, 21, every))


def test_run_ids_are_ros_parameters_and_never_zero() -> None:
    ids = {new_run_id() for _ in range(1000)}
    assert len(ids) == 1000
    assert all(0 < run_id < 2**63 for run_id in ids)


def test_of_those_that_wait_for_each_other_only_the_absent_are_named() -> None:
    keeper = clock(birds=5)
    reach(keeper, -1, "bird_01", "bird_02", "bird_04", "bird_05")
    assert keeper.waiting_for == ["bird_03"]
    reach(keeper, -1, "bird_03")
    reach(keeper, 0, "bird_01")
    assert keeper.waiting_for == ["bird_02", "bird_03", "bird_04", "bird_05"]
    assert not keeper.begun


def test_in_a_pause_nobody_is_waited_for() -> None:
    keeper = clock()
    reach(keeper, 0, *BIRDS)
    keeper.pause()
    assert keeper.waiting_for == list(BIRDS), "they have leave up to the pause"
    reach(keeper, 4, *BIRDS)
    assert keeper.paused
    assert keeper.waiting_for == []


def test_a_push_by_nothing_is_refused() -> None:
    # It would cost the flock a rewind.
    keeper = clock(record=True)
    reach(keeper, 0, *BIRDS, "recorder")
    with pytest.raises(FlockError, match="change nothing"):
        keeper.perturb(bird=1, member=1, step=10, position=0.0, speed=0.0)
    assert keeper.rewinds.count == 0
    assert keeper.perturb(bird=1, member=1, step=10, position=0.0, speed=1e-3)[0] == 10


def test_steps_asked_for_before_the_flight_begins_count_from_where_it_goes_on() -> None:
    keeper = clock(record=True, window=100, t_max=1000.0)
    assert keeper.take_steps(50) == []
    assert not keeper.leave_known
    reach(keeper, 300, "recorder")  # a flight that is resumed
    assert granted(reach(keeper, 300, *BIRDS)) == [350]
    assert keeper.pauses_at == 350


def test_a_pause_asked_for_before_the_flight_begins_is_where_it_goes_on() -> None:
    keeper = clock(record=True, t_max=1000.0)
    keeper.pause()
    reach(keeper, 300, "recorder")
    assert granted(reach(keeper, 300, *BIRDS)) == []
    assert keeper.paused
    assert keeper.pauses_at == 300
    assert [grant.step for grant in keeper.take_steps(2)] == [302]


def test_a_pause_during_a_rewind_is_where_leave_ended_before_it() -> None:
    keeper = clock(record=True, window=100, t_max=1000.0)
    reach(keeper, 0, *BIRDS, "recorder")
    (leave,) = granted(reach(keeper, 20, *BIRDS)[-1:])
    keeper.perturb(bird=1, member=0, step=0, position=0.1, speed=0.0)
    keeper.pause()
    assert keeper.pauses_at == leave
    assert keeper.take_steps(50) == []
    assert keeper.pauses_at == leave + 50


@pytest.mark.parametrize("members", [1, 400, 2000])
def test_a_push_of_all_members_is_one_message_whose_number_is_its_epoch(members: int) -> None:
    ratios = ",".join(["1.0"] * members)
    keeper = clock(record=True, span_ratios=(f"1={ratios}",))
    reach(keeper, 0, *BIRDS, "recorder")
    step, (push, grant) = keeper.perturb(bird=2, member=0, step=0, position=0.1, speed=0.0)
    assert len(push.each(members)) == members
    assert push.number == grant.epoch == grant.perturbation == 2
    assert step == push.step == 5


def test_a_push_is_repeated_until_the_recorder_has_begun_its_epoch() -> None:
    keeper = clock(record=True)
    reach(keeper, 0, *BIRDS, "recorder")
    assert keeper.repeated == [keeper.grant]
    _, (push, grant) = keeper.perturb(bird=2, member=0, step=0, position=0.1, speed=0.0)
    assert keeper.repeated == [push, grant]
    reach(keeper, 0, "recorder", epoch=2)
    assert keeper.repeated == [keeper.grant]


def test_a_recorder_that_waits_for_a_push_of_a_dead_clock_is_led_out_of_its_epoch() -> None:
    keeper = clock(record=True)
    reach(keeper, ABSENT, "recorder", epoch=1)
    assert keeper.saved == ABSENT, "it has not begun the epoch"
    assert "recorder" in keeper.waiting_for
    (grant,) = reach(keeper, ABSENT, "recorder", epoch=7)
    assert grant.epoch == 1 + CLOCKS
    assert grant.perturbation == 0


def test_the_epoch_after_the_last_is_the_first() -> None:
    keeper = Timekeeper(FlockConfiguration(birds=2), RUN, 4, False, epoch=2**32 - 1)
    (grant, _) = keeper.rewind()
    assert grant.epoch == 1
    assert ahead(1, 2**32 - 1) > 0
    assert ahead(2**32 - 1, 1) < 0
    assert reach(keeper, 0, "bird_01", epoch=2**32 - 1) == []
    assert keeper.ignored_for == {STALE: 1}


def test_a_clock_follows_no_epoch_out_of_reach() -> None:
    keeper = clock()
    reach(keeper, 0, *BIRDS)
    for epoch in (REACH + 2, 2**30, 2**31 - 1, 2**31, 2**31 + 1, 2**32 - REACH):
        for _ in range(3):  # a bird that is there reports it every second
            assert reach(keeper, 0, "bird_01", epoch=epoch) == []
    assert keeper.epoch == 1
    assert keeper.ignored_for == {STALE: 18}
    # It comes to the clock's epoch as another incarnation, which has forgotten that epoch.
    back = keeper.receive(Progress(RUN, -1, keeper.epoch, "bird_01", 2))
    assert [grant.epoch for grant in back][:1] == [2]


def pushed(keeper: Timekeeper, step: int) -> str:
    """The words with which a push is refused."""
    with pytest.raises(FlockError) as refused:
        keeper.perturb(bird=1, member=1, step=step, position=0.1, speed=0.0)
    assert keeper.rewinds.count == 0
    return str(refused.value)


@pytest.mark.parametrize("step", [0, 5, 20, 21])
def test_a_push_that_comes_too_late_is_told_so(step: int) -> None:
    keeper = clock(window=100, record=True)
    reach(keeper, 0, *BIRDS, "recorder")
    assert keeper.grant.step == 20
    told = pushed(keeper, step)
    assert "too late" in told
    assert "up to step 20, where the flight ends" in told
    assert "21" not in told, "of which no user has asked"


def test_a_push_is_told_when_it_can_be() -> None:
    keeper = clock(window=4, record=True)
    reach(keeper, 0, *BIRDS, "recorder")
    for step in (4, 21):
        assert f"step = {step}: must be 5..20" in pushed(keeper, step)
    keeper.stop()
    assert "too late" in pushed(keeper, 0)
    assert "up to step 4, where the flight ends" in pushed(keeper, 20)


def test_incarnations_of_a_node_are_remembered_up_to_a_number() -> None:
    nodes = Attendance(BIRDS, record=False)
    for incarnation in range(3 * MOST_INCARNATIONS):
        nodes.know("bird_01", 0)  # the genuine one, which reports again and again
        nodes.know("bird_01", incarnation)
    assert len(nodes._incarnations["bird_01"]) == MOST_INCARNATIONS
    assert not nodes.is_new("bird_01", 0)

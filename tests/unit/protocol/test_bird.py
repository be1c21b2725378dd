# SPDX-License-Identifier: Apache-2.0
"""A bird's step protocol: its waits and its messages. The flock flies bit for bit."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.handshake import handshake
from flock_sim.messages.rejection import FOREIGN, IMPOSSIBLE
from flock_sim.messages.types import Checkpoint, Grant, Progress, Stage, State, Wing
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.clock import Timekeeper
from flock_sim.protocol.session import Channel, Outgoing
from support.network import EPOCH, RUN, Kind, Network, expected_states


def configured(**parameters) -> FlockConfiguration:
    return FlockConfiguration(**{"birds": 3, "t_max": 8.0, "record_every": 1, **parameters})


def grant(step: int, configuration: FlockConfiguration, **changes) -> Grant:
    fields = {
        "run_id": RUN,
        "step": step,
        "end": configuration.steps,
        "dt": configuration.dt,
        "epoch": EPOCH,
    }
    return Grant(**{**fields, **changes})


def start(bird: BirdProtocol, step: int, configuration: FlockConfiguration) -> list[Outgoing]:
    """Tell a bird that the run begins, where, and how far it may go; return what it says."""
    out = bird.receive_grant(grant(0, configuration))
    out += bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH))
    return out + bird.receive_grant(grant(step, configuration))


def of(channel: Channel, out: list[tuple[Channel, bytes]]) -> list[bytes]:
    return [data for kind, data in out if kind is channel]


def pair() -> tuple[BirdProtocol, BirdProtocol, FlockConfiguration]:
    """Two birds that have heard no grant yet."""
    configuration = configured(birds=2)
    return BirdProtocol(1, configuration), BirdProtocol(2, configuration), configuration


# --- the distributed flight is the monolithic one ---

FLIGHTS = {
    "the default flock": {"birds": 13, "t_max": 50.0, "record_every": 10},
    "one": {"birds": 1, "t_max": 20.0, "record_every": 3},
    "one of two members": {"birds": 1, "t_max": 20.0, "span_ratios": ("1=0.9,1.2",)},
    "two": {"birds": 2, "t_max": 60.0},
    "even": {"birds": 8, "t_max": 15.0, "dt": 0.25, "record_every": 7},
    "spans that differ": {"birds": 5, "t_max": 60.0, "span_ratios": ("2=0.9", "4=1.1", "5=0.7")},
    "members": {"birds": 5, "t_max": 60.0, "span_ratios": ("2=0.9,1,1.1", "5=0.7")},
    "all-to-all, side by side": {"birds": 7, "t_max": 30.0, "coupling": "all"},
    "all-to-all, even": {"birds": 4, "t_max": 60.0, "coupling": "all"},
    "all-to-all, members": {
        "birds": 6,
        "t_max": 60.0,
        "coupling": "all",
        "span_ratios": ("2=0.9,1,1.1", "5=1.05"),
    },
    "coarse steps": {"birds": 5, "dt": 16.0, "t_max": 1600.0, "coupling": "all"},
    "never recorded again": {"birds": 3, "t_max": 20.0, "record_every": 100},
    "a member beyond all numbers": {"birds": 3, "t_max": 10.0, "span_ratios": ("2=1,1e100,1.1",)},
}


@pytest.mark.parametrize("window", [1, 8, 64])
@pytest.mark.parametrize("parameters", FLIGHTS.values(), ids=FLIGHTS)
@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_a_flock_of_birds_flies_as_the_monolith_does_to_the_bit(parameters, window):
    configuration = FlockConfiguration(**{"record_every": 1, **parameters})
    network = Network(configuration, window)
    network.deliver_all()
    assert network.finished
    expected = expected_states(configuration)
    assert {bird: log.states for bird, log in network.log.items()} == expected


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("coupling", ["nearest", "all"])
def test_the_order_of_messages_changes_no_bit(coupling, seed):
    configuration = configured(birds=6, t_max=20.0, coupling=coupling, span_ratios=("2=0.9,1.1",))
    network = Network(configuration, window=1 + seed)
    network.deliver_all(Random(seed))
    assert network.finished
    expected = expected_states(configuration)
    assert {bird: log.states for bird, log in network.log.items()} == expected


@pytest.mark.parametrize("kind", list(Kind))
def test_messages_of_one_kind_may_all_be_late(kind):
    network = Network(configured(birds=4, t_max=5.0), window=2)
    while network.in_flight:
        places = [k for k, letter in enumerate(network.in_flight) if letter.kind is not kind]
        network.deliver(places[0] if places else 0)
    assert network.finished
    expected = expected_states(network.configuration)
    assert {bird: log.states for bird, log in network.log.items()} == expected


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_a_member_that_diverges_changes_no_bit_of_the_others():
    # lambda^4 of 1e100 is beyond all numbers: that member is nan from the first step on.
    hurt = Network(configured(t_max=10.0, span_ratios=("2=1,1e100,1.1",)), window=4)
    whole = Network(configured(t_max=10.0, span_ratios=("2=1,1.05,1.1",)), window=4)
    hurt.deliver_all()
    whole.deliver_all()
    for bird in hurt.birds:
        ours = [State.decode(data) for data in hurt.log[bird].states]
        theirs = [State.decode(data) for data in whole.log[bird].states]
        assert len(ours) == len(theirs) == 11
        assert np.isnan(ours[-1].speed[1])
        for one, other in zip(ours, theirs, strict=True):
            for name in ("position", "speed", "circulation", "interaction_drag"):
                here, there = getattr(one, name)[[0, 2]], getattr(other, name)[[0, 2]]
                assert here.tobytes() == there.tobytes()


# --- one bird, by hand ---


def test_a_bird_says_nothing_before_the_first_grant():
    bird, other, configuration = pair()
    assert bird.waiting_for == "the clock's first grant"
    assert not bird.in_flight
    (wing,) = of(Channel.WING, other.receive_grant(grant(0, configuration)))
    assert bird.receive_wing(Wing.decode(wing)) == []
    out = bird.receive_grant(grant(0, configuration))
    assert [channel for channel, _ in out] == [Channel.WING, Channel.PROGRESS]
    out = bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH))
    assert [channel for channel, _ in out] == [Channel.STAGE]


def test_a_bird_waits_for_the_checkpoint_once_it_knows_its_neighbours():
    bird, _, configuration = pair()
    bird.receive_grant(grant(0, configuration))
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    assert bird.waiting_for.startswith("the checkpoint to continue from")
    assert not bird.in_flight


def test_a_bird_shows_its_wing_and_waits_for_its_neighbours():
    configuration = configured(span_ratios=("2=0.9,1.1",))
    bird = BirdProtocol(2, configuration)
    (channel, data), (_, here) = start(bird, 0, configuration)
    assert channel is Channel.WING
    assert Progress.decode(here) == Progress(RUN, -1, EPOCH, "bird_02")
    wing = Wing.decode(data)
    assert (wing.run_id, wing.bird, wing.span_ratio.tolist()) == (RUN, 2, [0.9, 1.1])
    assert bird.waiting_for == "the wing of bird_01, bird_03"
    bird.receive_wing(Wing(RUN, 1, np.ones(2)))
    assert bird.waiting_for == "the wing of bird_03"
    assert not bird.in_flight
    out = bird.receive_wing(Wing(RUN, 3, np.ones(2)))
    assert [channel for channel, _ in out] == [Channel.STAGE]
    assert bird.in_flight
    assert bird.waiting_for == "stage 0 of step 0 from bird_01, bird_03"
    assert bird.missing == [1, 3]


def test_a_stage_that_overtakes_its_senders_wing_is_kept_until_the_wing_is_here():
    # Wings and stages travel on topics of their own, and nothing orders one after the other.
    bird, other, configuration = pair()
    (wing,) = of(Channel.WING, start(bird, 0, configuration))
    (other_wing,) = of(Channel.WING, start(other, 0, configuration))
    (stage,) = of(Channel.STAGE, other.receive_wing(Wing.decode(wing)))
    assert bird.receive_stage(stage) == []
    out = bird.receive_wing(Wing.decode(other_wing))
    out += bird.receive_grant(grant(1, configuration))
    headers = [Stage.header(data) for data in of(Channel.STAGE, out)]
    assert [(step, stage) for _, step, _, _, stage, _ in headers] == [(0, 0), (0, 1)]
    assert bird.ignored == 0


def test_nothing_is_taken_for_a_stage_before_the_run_is_known():
    # Run 0 and epoch 0 are what a bird has before its first grant.
    configuration = configured(birds=2)
    bird = BirdProtocol(1, configuration)
    one = np.ones(1)
    assert bird.receive_stage(Stage(0, 0, 0, 2, 0, one, one, one).encode()) == []
    assert bird.ignored == 1
    assert bird.waiting_for == "the clock's first grant"


def test_a_bird_holds_at_the_step_that_it_was_granted():
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    start(bird, 0, configuration)
    assert (bird.step, bird.finished) == (0, False)
    assert bird.waiting_for == "the clock's grant beyond step 0"
    out = bird.receive_grant(grant(5, configuration))
    assert [State.decode(data).step for data in of(Channel.STATE, out)] == [1, 2, 3, 4, 5]
    assert len(of(Channel.STAGE, out)) == 4 * 5
    assert bird.step == 5
    for late in (5, 3, 0):
        assert bird.receive_grant(grant(late, configuration)) == []
    assert bird.ignored == 0
    bird.receive_grant(grant(8, configuration))
    assert bird.finished


@pytest.mark.parametrize(
    ("granted", "reported"), [(0, [0]), (1, [0, 1]), (2, [0, 1, 2]), (7, [0, 3, 7]), (8, [0, 4, 8])]
)
def test_a_bird_reports_half_way_and_where_its_leave_ends(granted, reported):
    # Half way, so that the next grant comes before it has to stop.
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    progress = of(Channel.PROGRESS, start(bird, granted, configuration))
    here, *later = (Progress.decode(data).step for data in progress)
    assert here == -1
    assert later == reported


def test_a_bird_that_waits_tells_how_far_it_has_come():
    configuration = configured(birds=2)
    bird = BirdProtocol(1, configuration, run_id=RUN)
    assert bird.report() == []
    start(bird, 0, configuration)
    for reached in (-1, 0):
        (data,) = of(Channel.PROGRESS, bird.report())
        assert Progress.decode(data).step == reached
        bird.receive_wing(Wing(RUN, 2, np.ones(1)))
        one = np.ones(1)
        bird.receive_stage(Stage(RUN, 0, EPOCH, 2, 0, one, one, one).encode())


def test_a_bird_that_waits_says_again_the_two_stages_that_a_neighbour_may_lack():
    configuration = configured(birds=2)
    bird = BirdProtocol(1, configuration, run_id=RUN)
    start(bird, 0, configuration)
    bird.receive_wing(Wing(RUN, 2, np.ones(1)))
    bird.receive_grant(grant(2, configuration))
    one = np.ones(1)
    ticks = [(0, 0)]
    for stage in range(3):
        said = of(Channel.STAGE, bird.report())
        assert [Stage.header(data)[1::3] for data in said] == ticks[-2:]
        bird.receive_stage(Stage(RUN, 0, EPOCH, 2, stage, one, one, one).encode())
        ticks.append((0, stage + 1))
    bird.receive_grant(grant(0, configuration, epoch=EPOCH + 1))
    assert of(Channel.STAGE, bird.report()) == [], "of an epoch that is over nobody lacks anything"


def test_a_bird_is_needed_until_the_clock_says_that_the_run_is_over():
    configuration = configured(birds=1)
    keeper = Timekeeper(configuration, RUN, window=100, record=False)
    bird = BirdProtocol(1, configuration)
    for message in keeper.first_messages:
        give = bird.receive_grant if isinstance(message, Grant) else bird.receive_checkpoint
        give(replace(message, epoch=EPOCH))
    bird.receive_grant(replace(keeper.grant, step=configuration.steps, epoch=EPOCH))
    assert bird.finished
    assert not bird.released
    assert bird.receive_grant(replace(keeper.release, epoch=EPOCH)) == []
    assert bird.released
    assert bird.step == configuration.steps


@pytest.mark.parametrize("beyond", [0, 1], ids=["an end", "a release"])
def test_one_grant_does_not_end_a_run_early_since_it_may_be_forged(beyond: int):
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    start(bird, 3, configuration)
    bird.receive_grant(grant(4 + beyond, configuration, end=4))
    bird.receive_grant(grant(6, configuration))
    bird.receive_grant(grant(7, configuration, end=6))
    out = bird.receive_grant(grant(8, configuration))
    assert State.step_of(of(Channel.STATE, out)[-1]) == bird.step == configuration.steps
    assert not bird.released


def test_a_forged_release_does_not_end_a_bird_that_has_not_begun():
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    bird.receive_grant(grant(0, configuration))
    bird.receive_grant(grant(configuration.steps + 1, configuration))
    assert not bird.released
    assert not bird.finished
    assert bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH)) == []
    assert "a new epoch from the clock" in bird.waiting_for  # it asks for one by its reports
    bird.receive_grant(grant(0, configuration, epoch=EPOCH + 1))
    bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH + 1))
    bird.receive_grant(grant(configuration.steps, configuration, epoch=EPOCH + 1))
    assert bird.step == configuration.steps


@pytest.mark.parametrize("beyond", [0, 1], ids=["an end", "a release"])
def test_a_second_grant_in_a_row_ends_a_run_early(beyond: int):
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    start(bird, 3, configuration)
    bird.receive_grant(grant(4, configuration, end=4))
    bird.receive_grant(grant(4 + beyond, configuration, end=4))
    assert bird.finished
    assert bird.step == 4
    assert bird.released == bool(beyond)


def test_a_bird_that_comes_back_when_the_run_is_over_is_not_needed():
    # The release is the last grant there is, and so the first that it hears: nobody answers it.
    configuration = configured()
    keeper = Timekeeper(configuration, RUN, window=100, record=False)
    bird = BirdProtocol(2, configuration, incarnation=9)
    bird.receive_grant(keeper.release)
    assert bird.released
    assert bird.finished


def test_a_new_epoch_takes_back_that_the_run_is_over():
    configuration = configured(birds=1)
    keeper = Timekeeper(configuration, RUN, window=100, record=False, epoch=EPOCH)
    bird = BirdProtocol(1, configuration)
    start(bird, configuration.steps, configuration)
    bird.receive_grant(keeper.release)
    assert bird.released
    keeper.rewind()
    bird.receive_grant(keeper.grant)
    assert not bird.released
    assert not bird.finished


def test_a_bird_does_not_begin_where_it_has_leave_to_be_further_already():
    # That leave was earned by a former life; it would wait for stages that nobody says again.
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    bird.receive_grant(grant(3, configuration))
    assert bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH)) == []
    assert not bird.in_flight
    bird.receive_grant(grant(0, configuration, epoch=EPOCH + 1))
    assert of(Channel.STATE, bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH + 1)))


def test_half_way_counts_from_where_the_bird_is_when_leave_comes():
    configuration = configured(birds=1, t_max=100.0)
    bird = BirdProtocol(1, configuration)
    start(bird, 10, configuration)
    progress = of(Channel.PROGRESS, bird.receive_grant(grant(30, configuration)))
    assert [Progress.decode(data).step for data in progress] == [20, 30]


def test_a_stage_one_ahead_is_kept_and_two_ahead_refused():
    configuration = configured()
    middle = BirdProtocol(2, configuration)
    for other in (1, 3):
        middle.receive_wing(Wing(RUN, other, np.ones(1)))
    start(middle, 8, configuration)

    def stage_of(bird, step, stage):
        position, speed = np.array([-1.8]), np.ones(1)
        return Stage(RUN, step, EPOCH, bird, stage, position, speed, speed).encode()

    assert middle.receive_stage(stage_of(1, 0, 0)) == []
    assert middle.receive_stage(stage_of(1, 0, 1)) == []
    assert middle.ignored == 0
    assert middle.receive_stage(stage_of(1, 0, 2)) == []
    assert middle.receive_stage(stage_of(3, 0, 2)) == []
    assert middle.ignored == 2
    # Bird 3's first stage brings the middle to stage 1, where bird 1 is already.
    out = middle.receive_stage(stage_of(3, 0, 0))
    assert [channel for channel, _ in out] == [Channel.STATE, Channel.STAGE]
    assert middle.missing == [3]


def test_what_a_bird_sent_does_not_change_when_it_flies_on():
    configuration = configured(birds=1)
    bird = BirdProtocol(1, configuration)
    first = start(bird, 1, configuration)
    kept = [bytes(bytearray(data)) for _, data in first]
    bird.receive_grant(grant(8, configuration))
    assert [data for _, data in first] == kept


def refused(bird, other):
    """Return the error by which a bird refuses the clock of another flight: at its second grant."""
    assert bird.receive_grant(other) == []
    with pytest.raises(FlockError) as error:
        bird.receive_grant(other)
    return str(error.value)


@pytest.mark.parametrize("change", [{"dt": 0.5}, {"end": 9}])
def test_a_clock_of_another_flight_is_refused(change):
    configuration = configured()
    error = refused(BirdProtocol(2, configuration), grant(0, configuration, **change))
    assert "bird_02 has 8 steps of dt = 1: give both the same configuration" in error


def test_a_clock_of_another_flight_is_refused_by_name():
    # What the clock's terms say goes before dt and end.
    configuration = configured()
    other = configured(coupling="all", t_max=9.0)
    another = grant(0, configuration, end=9, terms=handshake(other))
    error = refused(BirdProtocol(2, configuration), another)
    assert 'bird_02 has coupling = "nearest" where the clock has "all"' in error


def test_one_forged_grant_of_another_flight_does_not_end_a_bird_that_has_just_started():
    configuration = configured()
    other = grant(0, configuration, terms=handshake(configured(coupling="all")))
    bird = BirdProtocol(2, configuration)
    assert bird.receive_grant(other) == []
    assert bird.receive_grant(replace(other, terms=handshake(configured(t_max=9.0)))) == []
    assert bird.receive_grant(grant(0, configuration)) != []
    assert bird.receive_grant(other) == bird.receive_grant(other) == []
    assert bird.ignored_for == {FOREIGN: 4}


@pytest.mark.parametrize("change", [{"run_id": 0}, {"epoch": 0}, {"dt": 0.5}, {"dt": np.nan}])
def test_a_grant_that_no_clock_sends_changes_nothing(change):
    configuration = configured()
    bird = BirdProtocol(2, configuration)
    terms = handshake(configuration)
    assert bird.receive_grant(grant(0, configuration, terms=terms, **change)) == []
    assert bird.ignored == 1
    assert bird.run_id == 0
    assert of(Channel.WING, bird.receive_grant(grant(0, configuration, terms=terms)))


def test_a_neighbour_of_another_flock_is_counted_and_waited_for():
    # It is the clock's terms that refuse it, by name; its wing may come before it hears them.
    configuration = configured()
    bird = BirdProtocol(2, configuration)
    start(bird, 0, configuration)
    for ratio in (np.ones(3), np.empty(0), np.array([np.nan]), np.array([0.0]), np.array([-1.0])):
        assert bird.receive_wing(Wing(RUN, 1, ratio)) == []
    assert bird.ignored_for == {IMPOSSIBLE: 5}
    assert bird.waiting_for == "the wing of bird_01, bird_03"


def test_a_bird_told_its_run_waits_for_that_run():
    configuration = configured()
    bird = BirdProtocol(2, configuration, run_id=RUN)
    assert bird.receive_grant(grant(0, configuration, run_id=RUN + 1)) == []
    assert bird.ignored == 1
    assert of(Channel.WING, bird.receive_grant(grant(0, configuration)))


def test_grants_and_wings_of_others_are_counted_and_change_nothing():
    configuration = configured(birds=4)
    bird = BirdProtocol(2, configuration)
    bird.receive_grant(grant(0, configuration))
    strangers = [
        lambda: bird.receive_grant(grant(8, configuration, run_id=RUN + 1)),
        lambda: bird.receive_grant(grant(8, configuration, epoch=EPOCH - 1)),
        lambda: bird.receive_checkpoint(Checkpoint.of_start(RUN + 1, EPOCH)),
        lambda: bird.receive_checkpoint(Checkpoint.of_start(RUN, EPOCH - 1)),
        lambda: bird.receive_wing(Wing(RUN + 1, 1, np.ones(1))),
        lambda: bird.receive_wing(Wing(RUN, 4, np.ones(1))),
        lambda: bird.receive_wing(Wing(RUN, 2, np.ones(1))),
    ]
    for count, call in enumerate(strangers, start=1):
        assert call() == []
        assert bird.ignored == count
    assert bird.waiting_for == "the wing of bird_01, bird_03"

# SPDX-License-Identifier: Apache-2.0
"""Link models from outside the package."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numba.core.event import install_recorder

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.links import registry
from flock_sim.links.models import LinkModel
from flock_sim.links.registry import register
from flock_sim.messages.stage_layout import stage_words
from flock_sim.messages.types import Checkpoint, Grant, State, Wing
from flock_sim.protocol.bird import BirdProtocol
from flock_sim.protocol.latest_values import LatestValues
from flock_sim.protocol.link_receiver import LinkReceiver
from flock_sim.protocol.session import Channel
from flock_sim.reference.integrator import Reference

FAULTS = "interval=3,delay=2,jitter=1,drop=0.2,noise=0.001,timeout=30"


@pytest.fixture(autouse=True)
def only_here() -> Iterator[None]:
    yield
    del registry.MODELS[registry.BUILT_IN :]


def frozen(age, position, speed, circulation, rate):
    return position, circulation


def moved(age, position, speed, circulation, rate):
    return position + speed * age, circulation + rate * age


def flown(*links: str) -> np.ndarray:
    configuration = FlockConfiguration(birds=3, t_max=200.0, record_every=1, links=links)
    return np.stack([state.speed for state in Reference(configuration).fly()])


@pytest.mark.slow
def test_models_that_do_what_built_in_ones_do_make_the_same_flight_to_the_bit():
    register(LinkModel("frozen", frozen))
    register(LinkModel("moved", moved))
    mine = flown(f"frozen:{FAULTS}", f"2->1=moved:{FAULTS}", "3->2=exact")
    builtin = flown(f"hold:{FAULTS}", f"2->1=linear:{FAULTS}", "3->2=exact")
    np.testing.assert_array_equal(mine, builtin)
    assert not np.array_equal(mine, flown(f"frozen:{FAULTS}", "3->2=exact"))


def test_in_flight_nothing_is_compiled_for_a_registered_model():
    """A bird that compiled in flight would keep the others waiting."""
    flown("hold:interval=5")
    register(LinkModel("calm", frozen))
    links = ("calm:interval=5",)
    flock = FlockConfiguration(birds=3, t_max=10.0, links=links)
    with install_recorder("numba:compile") as compiled:
        flight = Reference(flock)
        receiver = LinkReceiver(2, flock)
        latest = LatestValues(2, (1, 3), flock)
    assert len(compiled.buffer) > 0
    with install_recorder("numba:compile") as compiled:
        flight.advance(10)
        stages, mine = np.ones((2, stage_words(1))), np.ones((2, stage_words(1)))
        receiver.listen(0, flight.flock.interactions(np.array([[1, 0], [1, 2]])), stages, mine)
        latest.known(0, 0)
    assert not compiled.buffer


def test_what_a_registered_model_raises_ends_the_flight():
    def failing(age, position, speed, circulation, rate):
        if age > 3.0:
            raise ValueError("too old")
        return position, circulation

    register(LinkModel("failing", failing))
    flight = Reference(
        FlockConfiguration(birds=2, dt=1.0, t_max=9.0, links=("failing:interval=9",))
    )
    flight.advance(3)
    with pytest.raises(ValueError, match="too old"):
        flight.advance(1)


def test_a_model_may_return_numbers_of_single_precision():
    def rounded(age, position, speed, circulation, rate):
        return np.float32(position), circulation

    register(LinkModel("rounded", rounded))
    assert flown("rounded:interval=2").tobytes() != flown("hold:interval=2").tobytes()


def test_a_bird_asks_the_registered_model_too():
    """It knows a neighbour without a wake, and so flies as if it were alone."""
    register(LinkModel("calm", lambda age, position, speed, circulation, rate: (position, 0.0)))
    flight = {"t_max": 20.0, "record_every": 5}
    flock = FlockConfiguration(birds=2, links=("calm:interval=20",), **flight)
    pair = [BirdProtocol(number, flock, run_id=1) for number in (1, 2)]
    alone = BirdProtocol(1, FlockConfiguration(birds=1, **flight), run_id=1)
    said = []
    for bird in (*pair, alone):
        bird.receive_grant(Grant(run_id=1, step=0, end=20, dt=1.0, epoch=1))
        for other in bird.neighbours:
            bird.receive_wing(Wing(1, other, flock.span_ratio[other - 1]))
        said.append(bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1)))
        said[-1] += bird.receive_grant(Grant(run_id=1, step=20, end=20, dt=1.0, epoch=1))
    for channel, data in said[1]:
        if channel is Channel.STAGE:
            said[0] += pair[0].receive_stage(data)
    speeds = [
        {
            state.step: state.speed.tobytes()
            for channel, data in told
            if channel is Channel.STATE and (state := State.decode(data))
        }
        for told in said
    ]
    assert list(speeds[0]) == [0, 5, 10, 15]  # at step 20 the other has something to say again
    assert speeds[0].items() <= speeds[2].items()


@pytest.mark.parametrize("name", ["hold", "Fading", "a:b", "", "3->4", "a b"])
def test_names_that_cannot_be_are_refused(name):
    with pytest.raises(FlockError, match=r"exists already|must be a letter"):
        register(LinkModel(name, frozen))
    assert len(registry.MODELS) == registry.BUILT_IN


@pytest.mark.parametrize(
    ("perceive", "why"),
    [
        (lambda age, position, speed, circulation, rate: position, "returns 0.0"),
        (lambda age, position, speed, circulation, rate: (position, 1), r"returns \(0.0, 1\)"),
        (lambda age, position, speed, circulation: (position, circulation), "expected 4, got 5"),
        (lambda age, position, speed, circulation, rate: print(age), "returns None"),
    ],
)
def test_what_is_no_model_is_refused_in_one_line(perceive, why):
    with pytest.raises(FlockError, match=f"^link model 'mine'.*{why}") as refusal:
        register(LinkModel("mine", perceive))
    assert "\n" not in str(refusal.value)
    assert len(registry.MODELS) == registry.BUILT_IN

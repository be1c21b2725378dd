# SPDX-License-Identifier: Apache-2.0
"""Flights over link models: the distributed flight equals one loop, and agrees with theory.

test_recovery tests kills and rewinds, too; test_network tests orders and duplicates.
"""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock_state import FlockState
from flock_sim.reference.integrator import Reference
from support.network import Kind, Network, expected_states
from support.random_links import random_links

ALL_FAULTS = (
    "delay=2/0/5,jitter=3,drop=0.3/0.1/0.8,position_noise=0.02,speed_noise=0/0.001/0,"
    "quantum=0.001,range=4/inf/5,timeout=6,seed=1/1/2"
)


def flown(configuration: FlockConfiguration, order: Random, window: int = 5) -> Network:
    network = Network(configuration, window)
    network.deliver_all(order)
    assert network.finished
    return network


def states(network: Network) -> dict[int, list[bytes]]:
    return {bird: log.states for bird, log in network.log.items()}


def last(configuration: FlockConfiguration) -> FlockState:
    return list(Reference(configuration).fly())[-1]


@pytest.mark.parametrize("coupling", ["nearest", "all"])
@pytest.mark.parametrize("model", ["exact", "hold", "hold:interval=4", "linear:interval=3"])
def test_a_flight_with_all_faults_is_that_of_the_monolith_to_the_bit(model, coupling):
    colon = "," if ":" in model else ":"
    configuration = FlockConfiguration(
        birds=4,
        coupling=coupling,
        t_max=40.0,
        record_every=3,
        span_ratios=("2=0.9,1.0,1.07",),
        links=(f"{model}{colon}{ALL_FAULTS}",),
    )
    network = flown(configuration, Random(1))
    assert states(network) == expected_states(configuration)


def test_any_mix_of_links_is_that_of_the_monolith_to_the_bit():
    for seed in range(40):
        random = Random(seed)
        birds, coupling = random.randint(1, 5), random.choice(["nearest", "all"])
        configuration = FlockConfiguration(
            birds=birds,
            coupling=coupling,
            t_max=30.0,
            record_every=random.randint(1, 4),
            links=random_links(random, birds, coupling, members=3),
        )
        network = flown(configuration, random, window=random.randint(1, 9))
        assert states(network) == expected_states(configuration), f"seed {seed}"


def test_links_that_are_exact_and_faultless_change_no_bit_and_have_no_memory():
    plain = FlockConfiguration(birds=5, t_max=50.0)
    said = FlockConfiguration(birds=5, t_max=50.0, links=("hold", "exact:seed=3", "2->3=exact"))
    assert said.link_table.plain
    assert not said.link_table.memory_ends.any()
    assert expected_states(said) == expected_states(plain)


@pytest.mark.parametrize(("links", "fewer"), [(("hold:interval=5",), 20), (("linear",), 4)])
def test_messages_are_fewer_by_the_stages_and_the_interval(links, fewer):
    def messages(*links: str) -> int:
        configuration = FlockConfiguration(birds=3, t_max=100.0, links=links)
        network = flown(configuration, Random(2))
        return sum(letter.kind is Kind.STAGE for letter in network.delivered)

    # Four links. At step 100, the end, there is an exchange at stage 0 only.
    assert messages() == 4 * (4 * 100 + 1)
    assert messages(*links) == 4 * (4 * 100 // fewer + 1)


def test_one_exact_link_has_the_whole_flock_exchange_every_stage():
    configuration = FlockConfiguration(birds=3, t_max=10.0, links=("hold:interval=5", "1->2=exact"))
    network = flown(configuration, Random(2))
    assert sum(letter.kind is Kind.STAGE for letter in network.delivered) == 4 * 41
    assert states(network) == expected_states(configuration)


DT = 1.0 / 16.0


def deviation(links: str, coupling: str = "nearest") -> float:
    """How far positions are from those over exact links after 16 b/U_min of the transient, in b."""
    flight = {"birds": 5, "coupling": coupling, "dt": DT, "t_max": 16.0, "record_every": 256}
    over_links = last(FlockConfiguration(**flight, links=(links,)))
    exact = last(FlockConfiguration(**flight))
    return float(np.abs(over_links.position - exact.position).max())


@pytest.mark.parametrize(("model", "order"), [("hold", 1), ("linear", 2)])
def test_models_converge_with_their_order_in_the_interval(model, order):
    # What is held is half an interval K old on average, and what `linear` leaves out goes with the
    # mean square of the age. The deviation is c K^p (1 + d K), so that log2 of the ratio for K and
    # K/2 is p + d K / (2 ln 2). d K is the distance that a neighbour is seen behind, U K dt / 2,
    # over that in which the interaction changes, b; it halves with K.
    intervals = np.array([8, 4, 2, 1])
    errors = np.array([deviation(f"{model}:interval={interval}") for interval in intervals])
    orders = np.log2(errors[:-1] / errors[1:])
    bounds = (18.5 / 18.0) * intervals[:-1] * DT / 2.0 / (2.0 * math.log(2.0))
    assert np.all(abs(orders - order) < bounds), (errors, orders)


def test_delays_of_a_member_change_no_bit_of_another():
    together = last(FlockConfiguration(birds=5, t_max=50.0, links=("hold:delay=0/3/7,drop=0.2",)))
    for member, delay in enumerate((0, 3, 7)):
        alone = last(
            FlockConfiguration(birds=5, t_max=50.0, links=(f"hold:delay={delay},drop=0.2",))
        )
        assert np.array_equal(together.position[:, [member]], alone.position)
        assert np.array_equal(together.interaction_drag[:, [member]], alone.interaction_drag)


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
def test_a_member_that_diverges_changes_no_bit_of_another():
    fault = "linear:interval=2,drop=0.2,noise=0.01,range=9"
    flight = {"birds": 3, "t_max": 60.0, "links": (fault,)}
    calm = last(FlockConfiguration(**flight))
    wild = last(FlockConfiguration(**flight, span_ratios=("2=1,1e100,1",)))
    for member in (0, 2):
        assert np.array_equal(wild.position[:, [member]], calm.position)
    assert not np.isfinite(wild.position[:, 1]).all()


def test_birds_that_hear_nothing_fly_alone():
    for fault in ("range=0.1", "timeout=0,delay=1", "delay=1000"):
        configuration = FlockConfiguration(birds=3, t_max=200.0, links=(f"hold:{fault}",))
        flock = last(configuration)
        assert not flock.interaction_drag.any()
        # All three keep their cruising speed but for the rounding of 800 stages.
        assert flock.speed == pytest.approx(18.5 / 18.0, rel=1e-12)


def test_a_flight_looked_at_on_the_way_is_the_same():
    configuration = FlockConfiguration(birds=3, t_max=50.0, links=("linear:interval=3,jitter=4",))
    watched, unwatched = Reference(configuration), Reference(configuration)
    for _ in range(50):
        watched.observe()
        watched.advance(1)
    unwatched.advance(50)
    assert np.array_equal(watched.observe(), unwatched.observe())

# SPDX-License-Identifier: Apache-2.0
"""No network can change a bit of a flight: an adversary controls every message."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.stage_layout import HEADER, HEADER_AT
from flock_sim.messages.types import Grant, Wing
from support.forgeries import STAGE_HEADERS, with_header
from support.network import CLOCK, EPOCH, RUN, Kind, Letter, Network, expected_states
from support.random_forcing import random_forcing
from support.random_links import random_links

SPANS = ("0.9", "1.0", "1.07")


@st.composite
def configurations(draw) -> FlockConfiguration:
    birds = draw(st.integers(1, 5))
    members = draw(st.integers(1, 2))
    entries = []
    for bird in range(1, birds + 1):
        if draw(st.booleans()):
            ratios = draw(st.lists(st.sampled_from(SPANS), min_size=members, max_size=members))
            entries.append(f"{bird}={','.join(ratios)}")
    dt = draw(st.sampled_from([0.5, 1.0, 4.0]))
    coupling = draw(st.sampled_from(["nearest", "all"]))
    links = ()
    if draw(st.booleans()):
        random = Random(draw(st.integers(0, 2**32 - 1)))
        links = random_links(random, birds, coupling, members if entries else 2)
    steps = draw(st.integers(1, 8))
    moments = st.tuples(st.integers(1, birds), st.integers(0, steps))
    pushes = draw(st.lists(moments, max_size=3))
    forcing = ()
    if draw(st.booleans()):
        random = Random(draw(st.integers(0, 2**32 - 1)))
        forcing = random_forcing(random, birds, members if entries else 2)
    configuration = FlockConfiguration(
        birds=birds,
        coupling=coupling,
        dt=dt,
        t_max=dt * steps,
        record_every=draw(st.integers(1, 3)),
        span_ratios=tuple(entries),
        perturbations=tuple(f"{bird}@{step}=0.1,-0.003" for bird, step in pushes),
        links=links,
        forcing=forcing,
    )
    configuration.load_laws()
    return configuration


class Adversary(RuleBasedStateMachine):
    """Delays, reorders, repeats, loses and invents messages.

    In the end everything arrives but stages that were lost for good, which birds say again.
    """

    @initialize(
        configuration=configurations(),
        window=st.integers(1, 5),
        known_run=st.booleans(),
        seed=st.integers(0, 2**32 - 1),
    )
    def take_off(self, configuration, window, known_run, seed):
        self.network = Network(configuration, window, run_id=RUN if known_run else 0)
        self.lost: list[Letter] = []
        self.random = Random(seed)

    @property
    def some_in_flight(self) -> bool:
        return bool(self.network.in_flight)

    @precondition(lambda self: self.some_in_flight)
    @rule(at=st.integers(0, 1000))
    def deliver(self, at):
        self.network.deliver(at)

    @precondition(lambda self: self.some_in_flight)
    @rule(count=st.integers(2, 60))
    def deliver_many_in_any_order(self, count):
        for _ in range(count):
            if self.network.in_flight:
                self.network.deliver(self.random.randrange(len(self.network.in_flight)))

    @precondition(lambda self: self.some_in_flight)
    @rule(to=st.integers(1, 5), count=st.integers(1, 20))
    def deliver_to_one_bird_only(self, to, count):
        for _ in range(count):
            places = [k for k, letter in enumerate(self.network.in_flight) if letter.to == to]
            if places:
                self.network.deliver(self.random.choice(places))

    @precondition(lambda self: self.some_in_flight)
    @rule(at=st.integers(0, 1000))
    def deliver_a_copy(self, at):
        self.network.hand_over(self.network.in_flight[at % len(self.network.in_flight)])

    @precondition(lambda self: self.network.delivered)
    @rule(at=st.integers(0, 1000), times=st.integers(1, 3))
    def replay(self, at, times):
        letter = self.network.delivered[-1 - at % len(self.network.delivered)]
        for _ in range(times):
            self.network.hand_over(letter)

    @precondition(lambda self: self.some_in_flight)
    @rule(at=st.integers(0, 1000))
    def lose(self, at):
        in_flight = self.network.in_flight
        self.lost.append(in_flight.pop(at % len(in_flight)))

    @precondition(lambda self: self.lost)
    @rule(at=st.integers(0, 1000))
    def send_again(self, at):
        self.network.in_flight.append(self.lost.pop(at % len(self.lost)))

    @precondition(lambda self: self.some_in_flight)
    @rule(at=st.integers(0, 1000))
    def lose_a_stage_for_good(self, at):
        in_flight = self.network.in_flight
        places = [k for k, letter in enumerate(in_flight) if letter.kind is Kind.STAGE]
        if places:
            del in_flight[places[at % len(places)]]

    @rule(to=st.integers(0, 4))
    def say_again(self, to):
        self.network.say_again(1 + to % self.network.configuration.birds)

    @rule(to=st.integers(0, 4), data=st.binary(max_size=200))
    def garbage(self, to, data):
        self.network.hand_over_forgery(1 + to % self.network.configuration.birds, data)

    @rule(to=st.integers(0, 4), fill=st.integers(1, 255))
    def garbage_of_the_right_size(self, to, fill):
        size = 4 + HEADER.size + 24 * self.network.configuration.members + 16
        self.network.hand_over_forgery(
            1 + to % self.network.configuration.birds, bytes([fill]) * (size - 4)
        )

    @rule(at=st.integers(0, 1000), how=st.sampled_from(sorted(STAGE_HEADERS)))
    def forge(self, at, how):
        # What is on its way would be welcome, but for the one thing that is changed.
        letters = self.network.in_flight + self.network.delivered
        stages = [letter for letter in letters if letter.kind is Kind.STAGE]
        if stages:
            letter = stages[at % len(stages)]
            bird, flight = self.network.birds[letter.to], self.network.configuration
            forged = with_header(letter.data, STAGE_HEADERS[how], bird, flight)
            self.network.hand_over_forgery(letter.to, forged)

    @rule(at=st.integers(0, 1000), newer=st.sampled_from([1, 2, 9, 2**24, 2**30]))
    def herald(self, at, newer):
        # Of an epoch that no grant has begun: it may be kept, and moves nobody.
        letters = self.network.in_flight + self.network.delivered
        stages = [letter for letter in letters if letter.kind is Kind.STAGE]
        if stages:
            letter = stages[at % len(stages)]
            header = HEADER.unpack_from(letter.data, HEADER_AT)
            early = bytearray(letter.data)
            HEADER.pack_into(early, HEADER_AT, *header[:2], EPOCH + newer, *header[3:])
            bird = self.network.birds[letter.to]
            before = bird.ignored
            assert bird.receive_stage(bytes(early)) == []
            assert bird.ignored - before in (0, 1)

    @rule(at=st.integers(0, 1000), cut=st.integers(-8, 8).filter(bool))
    def change_the_length(self, at, cut):
        letters = self.network.in_flight + self.network.delivered
        stages = [letter for letter in letters if letter.kind is Kind.STAGE]
        if stages:
            letter = stages[at % len(stages)]
            data = letter.data + bytes(cut) if cut > 0 else letter.data[:cut]
            self.network.hand_over_forgery(letter.to, data)

    @rule(to=st.integers(0, 4), run=st.sampled_from([0, RUN - 1, RUN + 1]))
    def wing_of_another_run(self, to, run):
        bird = self.network.birds[1 + to % self.network.configuration.birds]
        for other in bird.neighbours:
            ratio = self.network.configuration.span_ratio[other - 1] + 0.5
            assert bird.receive_wing(Wing(run, other, ratio)) == []

    @rule(to=st.integers(0, 4), off=st.sampled_from([(1, 0), (1, 1), (0, -1)]))
    def grant_of_another_run_or_an_older_epoch(self, to, off):
        number = 1 + to % self.network.configuration.birds
        bird, configuration = self.network.birds[number], self.network.configuration
        if self.network.log[number].limit >= 0:  # the first grant heard begins the run
            before = bird.ignored
            steps, dt = configuration.steps, configuration.dt
            assert bird.receive_grant(Grant(RUN + off[0], steps, steps, dt, EPOCH + off[1])) == []
            assert bird.ignored == before + 1

    def teardown(self):
        if not hasattr(self, "network"):
            return
        network = self.network
        network.in_flight += self.lost
        network.deliver_all(self.random)
        # Each time that all who wait say so again, somebody goes on by an exchange or more.
        exchange_schedule, steps = (
            network.configuration.link_table.exchange_schedule,
            network.configuration.steps,
        )
        for _ in range(exchange_schedule.exchanges(0, steps) + 1):
            for bird in network.birds:
                network.say_again(bird)
            network.deliver_all(self.random)
        assert network.finished
        expected = expected_states(network.configuration)
        assert {bird: log.states for bird, log in network.log.items()} == expected


TestAdversary = pytest.mark.slow(Adversary.TestCase)
TestAdversary.settings = settings(max_examples=300, stateful_step_count=40)


def test_forgeries_are_told_from_the_genuine_by_the_header_alone():
    # The adversary above changes one thing at a time: unchanged, the message would be taken.
    network = Network(FlockConfiguration(birds=2, t_max=4.0), window=4)
    while not any(letter.kind is Kind.STAGE and letter.to != CLOCK for letter in network.in_flight):
        network.deliver(0)
    letter = next(letter for letter in network.in_flight if letter.kind is Kind.STAGE)
    header = HEADER.unpack_from(letter.data, HEADER_AT)
    assert header == (RUN, 0, EPOCH, 3 - letter.to, 0, 1)
    bird = network.birds[letter.to]
    for forge in STAGE_HEADERS.values():
        forged = with_header(letter.data, forge, bird, network.configuration)
        network.hand_over_forgery(letter.to, forged)
    network.deliver_all()
    assert network.finished

# SPDX-License-Identifier: Apache-2.0
"""After kills and restarts at any time, each row is recorded once, in order, bit for bit.

FLOCK_TORTURE=1 tries many more flights.
"""

from __future__ import annotations

import os
from dataclasses import replace
from random import Random

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from support.random_forcing import random_forcing
from support.random_links import random_links
from support.simulator.forger import Forger
from support.simulator.world import CLOCK, World

TORTURE = bool(os.environ.get("FLOCK_TORTURE"))


@pytest.fixture(autouse=True)
def small_queues(monkeypatch: pytest.MonkeyPatch) -> None:
    # Eight rows ahead of the disk, sixteen in a queue: flights of a few steps come to the limit.
    monkeypatch.setattr(topics, "STATE_BYTES_AHEAD", 1)


def random_world(seed: int, linked: bool = False) -> World:
    """A flight that is small enough for every kind of coincidence to happen in it."""
    random = Random(seed)
    birds = random.randint(1, 4)
    every = random.randint(1, 3)
    spans = ("1=1e100,1",) if random.random() < 0.1 else ("1=0.9", f"{birds}=1.07")[: birds - 1]
    coupling = random.choice(["nearest", "all"])
    members = random.choice([1, 2])
    configuration = FlockConfiguration(
        birds=birds,
        coupling=coupling,
        t_max=float(random.randint(1, 24)),
        record_every=every,
        span_ratios=spans,
        links=random_links(random, birds, coupling, members) if linked else (),
    )
    if random.random() < 0.5:
        terms = random_forcing(random, birds, members)
        configuration = replace(configuration, forcing=terms)
        configuration.load_laws()
    record = random.random() < 0.75
    stages = record and random.random() < 0.3
    return World(configuration, random.choice([1, 2, 5, 64]), random, record=record, stages=stages)


def trouble(world: World, deaths: int, calm: int) -> None:
    """Kill, deliver, bring back, in any order; about `calm` messages between two deaths."""
    random = world.random
    while world.deaths < deaths and not world.over:
        what = random.random()
        if world.dead and what < 0.25:
            world.bring(*random.sample(world.dead, k=random.randint(1, len(world.dead))))
        elif what < 0.35:
            world.flush()
        elif what < 0.40:
            world.report()
        elif what < 0.41 and CLOCK in world.living:
            random.choice([world.stop, world.keeper.pause, world.resume, world.resume])()
        elif what < 0.55:
            names = list(world.living)
            if names and random.random() < 0.5:
                count = len(names) if random.random() < 0.05 else min(len(names), 2)
                world.kill(*random.sample(names, k=random.randint(1, count)))
        else:
            world.deliver_some(random.randint(1, calm))
        if random.random() < 0.1:
            world.deliver_some(random.randint(1, calm), to=random.choice(world.everybody))


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
@pytest.mark.parametrize("linked", [False, True], ids=["plain", "linked"])
@pytest.mark.parametrize("hundred", range(50 if TORTURE else 2))
def test_a_flight_full_of_deaths_is_the_flight_without(hundred: int, linked: bool) -> None:
    for seed in range(100 * hundred, 100 * (hundred + 1)):
        world = random_world(seed, linked)
        try:
            trouble(world, deaths=1 + seed % 9, calm=5 + 3 * (seed % 40))
            world.settle()
        except AssertionError as error:
            raise AssertionError(f"seed {seed}") from error


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
@pytest.mark.parametrize("hundred", range(50 if TORTURE else 2))
def test_a_flight_full_of_forged_epochs_is_the_flight_without(hundred: int) -> None:
    for seed in range(100 * hundred, 100 * (hundred + 1)):
        world = random_world(seed)
        forger = Forger(world)
        try:
            for _ in range(1 + seed % 5):
                trouble(world, deaths=world.deaths + seed % 2, calm=5 + 3 * (seed % 40))
                if not world.over:
                    world.bring(*world.dead)
                for _ in range(world.random.randint(1, 4)):
                    forger.epoch()
                    world.deliver_some(world.random.randint(1, 30))
            world.settle()
        except AssertionError as error:
            raise AssertionError(f"seed {seed}") from error


class Mortality(RuleBasedStateMachine):
    """Kills and brings back whom it likes, and delivers; in the end all live and hear."""

    @initialize(seed=st.integers(0, 2**32 - 1), crowd=st.booleans(), linked=st.booleans())
    def take_off(self, seed: int, crowd: bool, linked: bool) -> None:
        self.world = random_world(seed, linked)
        if crowd:
            self.world.bring(*self.world.everybody)

    @property
    def goes_on(self) -> bool:
        return not self.world.over

    @precondition(lambda self: self.goes_on and self.world.dead)
    @rule(at=st.integers(0, 5))
    def bring_one(self, at: int) -> None:
        self.world.bring(self.world.dead[at % len(self.world.dead)])

    @precondition(lambda self: self.goes_on and self.world.dead)
    @rule()
    def bring_all(self) -> None:
        self.world.bring(*self.world.dead)

    @precondition(lambda self: self.goes_on and self.world.living)
    @rule(at=st.integers(0, 5))
    def kill_one(self, at: int) -> None:
        names = sorted(self.world.living)
        self.world.kill(names[at % len(names)])

    @precondition(lambda self: self.goes_on and self.world.living)
    @rule(data=st.data())
    def kill_several(self, data: st.DataObject) -> None:
        names = sorted(self.world.living)
        self.world.kill(*data.draw(st.lists(st.sampled_from(names), min_size=1, unique=True)))

    @precondition(lambda self: self.goes_on)
    @rule(at=st.integers(0, 5))
    def restart_at_once(self, at: int) -> None:
        names = self.world.everybody
        who = names[at % len(names)]
        if who in self.world.living:
            self.world.kill(who)
        self.world.bring(who)

    @rule(at=st.integers(0, 1000), copy=st.booleans())
    def deliver(self, at: int, copy: bool) -> None:
        if queues := self.world.deliverable():
            self.world.deliver(queues[at % len(queues)], copy=copy)

    @rule(count=st.integers(2, 300))
    def deliver_many(self, count: int) -> None:
        self.world.deliver_some(count)

    @rule(at=st.integers(0, 5), count=st.integers(1, 50))
    def deliver_to_one(self, at: int, count: int) -> None:
        names = self.world.everybody
        self.world.deliver_some(count, to=names[at % len(names)])

    @precondition(lambda self: self.goes_on and CLOCK in self.world.living)
    @rule(how=st.sampled_from(["stop", "pause", "resume", "resume", "step"]))
    def operate(self, how: str) -> None:
        {
            "stop": self.world.stop,
            "pause": self.world.keeper.pause,
            "resume": self.world.resume,
            "step": self.world.take_a_step,
        }[how]()

    @rule()
    def flush(self) -> None:
        self.world.flush()

    @rule()
    def report(self) -> None:
        self.world.report()

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.world.settle()


TestMortality = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")(
    Mortality.TestCase
)
TestMortality.settings = settings(
    max_examples=2000 if TORTURE else 100, stateful_step_count=60 if TORTURE else 30
)

# SPDX-License-Identifier: Apache-2.0
"""Random simulated flights with all faults. A seed gives the same flight each time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from unittest.mock import patch

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.physics.runge_kutta import STAGES
from support.random_forcing import random_forcing
from support.random_links import random_links
from support.simulator.forger import Forger
from support.simulator.world import CLOCK, World

MOST_TRIES = 100
"""Most deliveries until the clock accepts a push."""


def random_configuration(random: Random) -> FlockConfiguration:
    """Return a flight of one to six birds and at most 96 steps, most of them short."""
    birds = random.randint(1, 6)
    members = random.choice([1, 1, 2, 3])
    steps = random.choice([random.randint(1, 24), random.randint(1, 24), random.randint(25, 96)])
    dt = random.choice([0.5, 1.0, 4.0])
    coupling = random.choice(["nearest", "all"])
    spans = [
        f"{bird}={','.join(str(random.choice([0.9, 1.0, 1.07])) for _ in range(members))}"
        for bird in random.sample(range(1, birds + 1), k=random.randint(members > 1, birds))
    ]
    pushes = [
        f"{random.randint(1, birds)}@{random.randint(0, steps)}=0.1,-0.003"
        for _ in range(random.choice([0, 0, 1, 3]))
    ]
    flight = FlockConfiguration(
        birds=birds,
        coupling=coupling,
        dt=dt,
        t_max=dt * steps,
        record_every=random.randint(1, 3),
        span_ratios=tuple(spans),
        perturbations=tuple(pushes),
        links=random_links(random, birds, coupling, members) if random.random() < 0.5 else (),
    )
    if random.random() < 0.4:
        flight = replace(flight, forcing=random_forcing(random, birds, members))
        flight.load_laws()
    return flight


@dataclass(frozen=True)
class Faults:
    """The relative frequency of each kind of event in a flight, and how many faults there are."""

    count: int
    calm: int
    """About the number of deliveries between two events."""
    weights: dict[str, int]

    @classmethod
    def draw(cls, random: Random, *, forged: bool, pushed: bool) -> Faults:
        """Draw a mixture: each kind is frequent in some flights and absent in others."""
        kinds = ["kill", "kill all", "lose", "twin", "kill twin", "rewind", "stop", "pause"]
        kinds += ["step", *(["forge"] if forged else []), *(["push"] if pushed else [])]
        frequent = random.sample(kinds, k=random.randint(1, len(kinds) // 2))
        weights = {kind: 16 if kind in frequent else random.choice([0, 0, 1]) for kind in kinds}
        if forged:
            weights["forge"] = random.choice([4, 64])
        weights["kill all"] = min(weights["kill all"], 1)
        weights["stop"] = min(weights["stop"], random.choice([0, 0, 0, 1]))
        return cls(random.choice([0, 1, 5, 20, 60]), random.choice([1, 5, 20, 60]), weights)


class RandomFlight:
    """The flight of a seed. `fly` flies it to its end and checks it."""

    def __init__(self, seed: int) -> None:
        self.events: Counter[str] = Counter()
        """How often each kind of fault has happened."""
        random = Random(seed)
        configuration = random_configuration(random)
        record = random.random() < 0.75
        stages = record and random.random() < 0.3
        forged, pushed = random.random() < 0.5, record and random.random() < 0.4
        # A push needs a step that is not granted yet.
        window = random.choice([1, 2, 5] if pushed else [1, 2, 5, random.randint(1, 64), 64])
        self.world = World(configuration, window, random, record=record, stages=stages)
        self._forger = Forger(self.world, pushed=pushed)
        self._messages = STAGES * configuration.steps * configuration.birds**2
        """About the number of deliveries of the flight without faults."""
        self._flies_on = random.choice([0.0, 0.3, 0.8])
        self._faults = Faults.draw(random, forged=forged, pushed=pushed)
        self._actions: dict[str, Callable[[], object]] = {
            "kill": self._kill,
            "kill all": self._kill_all,
            "lose": self.world.wires.lose_stage,
            "twin": self._start_twin,
            "kill twin": self._kill_twin,
            "forge": self._forger.anything,
            "push": self._push,
            "rewind": lambda: self._with_clock(self.world.rewind),
            "stop": lambda: self._with_clock(self.world.stop),
            "pause": lambda: self._with_clock(lambda: self.world.keeper.pause()),
            "step": lambda: self._with_clock(self.world.take_a_step),
        }

    def fly(self) -> None:
        """Let all faults happen, then settle.

        Queues are small, so that short flights reach their limits. Numbers may overflow.
        """
        with patch.object(topics, "STATE_BYTES_AHEAD", 1), np.errstate(all="ignore"):
            self._fly()

    def _fly(self) -> None:
        world, random, faults = self.world, self.world.random, self._faults
        names = [name for name, weight in faults.weights.items() if weight]
        weights = [faults.weights[name] for name in names]
        if random.random() < 0.7:
            world.bring(*random.sample(world.dead, k=len(world.dead)))
        for _ in range(faults.count if names else 0):
            if random.random() < self._flies_on:
                self._fly_on()
            else:
                self._go_on()
            if world.over:
                break
            self._actions[random.choices(names, weights)[0]]()
        for _ in range(random.choice([0, 0, 1, 5])):
            world.wires.lose_stage()
        world.settle()
        self._count()

    def _count(self) -> None:
        world = self.world
        self.events = Counter(
            {
                "processes killed": world.deaths,
                "stages lost": world.wires.lost,
                "messages forged": world.forged,
                "pushes flown": len(world.disk.live),
                "epochs begun": world.epochs,
                "twins started": world.twins_started,
            }
        )

    def _fly_on(self) -> None:
        """Let the flock fly for some steps, so that faults hit it in flight."""
        world, random = self.world, self.world.random
        world.bring(*random.sample(world.dead, k=len(world.dead)))
        world.resume()
        step = max(0, world.keeper.step)
        target = step + random.randint(1, 1 + (world.keeper.end - step) // 2)
        for _ in range(self._messages):
            if world.over or world.keeper.step >= target:
                return
            if not world.deliver_some(1):
                world.flush()
                if not world.deliverable():
                    world.report()
                    if random.random() < 0.1:
                        return

    def _go_on(self) -> None:
        """Do what is no fault, once or several times: deliver, restart, flush, report or resume."""
        while not self.world.over:
            self._do_no_fault()
            if self.world.random.random() < 0.4:
                return

    def _do_no_fault(self) -> None:
        world, random = self.world, self.world.random
        what = random.random()
        if world.dead and what < 0.4:
            world.bring(*random.sample(world.dead, k=random.randint(1, len(world.dead))))
        elif what < 0.5:
            world.flush()
        elif what < 0.55:
            world.report()
        elif what < 0.6:
            self._with_clock(world.resume)
        elif what < 0.63:
            world.let_end()
        elif what < 0.7:
            to = random.choice(world.everybody)
            world.deliver_some(random.randint(1, self._faults.calm), to=to)
        else:
            world.deliver_some(random.randint(1, 2 * self._faults.calm))

    def _with_clock(self, action: Callable[[], object]) -> None:
        if CLOCK in self.world.living and not self.world.over:
            action()

    def _kill(self) -> None:
        names = list(self.world.living)
        if names:
            victims = self.world.random.randint(1, min(2, len(names)))
            self.world.kill(*self.world.random.sample(names, k=victims))

    def _kill_all(self) -> None:
        self.world.kill(*list(self.world.living))

    def _start_twin(self) -> None:
        live = [who for who in self.world.birds if who in self.world.living]
        if live and len(self.world.twins) < 2:
            self.world.bring(self.world.random.choice(live))

    def _kill_twin(self) -> None:
        if self.world.twins:
            self.world.kill_twin(self.world.random.choice(self.world.twins))

    def _push(self) -> None:
        world, random = self.world, self.world.random
        bird = random.randint(1, world.configuration.birds)
        member = random.randint(0, world.configuration.members)
        change = random.uniform(-0.3, 0.3), random.choice([0.0, random.uniform(-0.01, 0.01)])
        for _ in range(MOST_TRIES):
            if world.over or (CLOCK in world.living and world.push(bird, member, *change)):
                return
            world.deliver_some(1)

# SPDX-License-Identifier: Apache-2.0
"""The fast path and the normal path, also among forged messages, fly the same bits."""

from __future__ import annotations

import time
from collections import Counter
from random import Random
from typing import Any, ClassVar

import numpy as np
import pytest

from flock_interfaces.msg import BirdStage
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages import topics
from flock_sim.messages.rejection import AGAIN
from flock_sim.messages.stage_layout import stage_numbers
from flock_sim.messages.types import Checkpoint, Grant, Stage, Wing
from flock_sim.nodes.bird import BirdNode
from flock_sim.physics.runge_kutta import STAGES
from flock_sim.protocol.stage_words import FIRST, PUBLISHER, SUBSCRIPTION
from flock_sim.reference.integrator import Reference
from flock_sim.ros import compiled_exchange
from flock_sim.ros.endpoints import latched
from flock_sim.ros.process import executing
from flock_tools.testing import fly, ros_alone

FLOCK = {
    "birds": 4,
    "t_max": 400,
    "record_every": 10,
    "span_ratios": ["2=0.97,1.03"],
    "perturbations": ["3@57=0.1,-0.01"],
}
CONFIGURATION = FlockConfiguration.from_parameters(FLOCK)


class Observed(BirdNode):
    """A bird that counts what comes of its exchange."""

    outcomes: ClassVar[Counter[int]] = Counter()

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        assert self._exchange is not None
        go_on = self._exchange.go_on

        def counted() -> int:
            outcome = go_on()
            Observed.outcomes[outcome] += 1
            return outcome

        self._exchange.go_on = counted  # type: ignore[method-assign]


class Asked(Observed):
    """A bird that is asked for something at random moments."""

    random = Random(3)

    def drain(self) -> bool:
        if self.random.random() < 0.3:
            assert self.protocol.waiting_for
        return super().drain()


class Mute(Observed):
    """A bird whose fast path has nothing to send by."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._exchange._words[PUBLISHER] = 0  # type: ignore[union-attr]


class Deaf(Observed):
    """A bird whose fast path has nothing to take by."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._exchange._words[FIRST + SUBSCRIPTION] = 0  # type: ignore[union-attr]


class Plain(BirdNode):
    """A bird that makes sure that it has no exchange."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        assert self._exchange is None


class Forging(Observed):
    """A bird that says what is false in the name of the others, in the first half of a flight."""

    sent: ClassVar[Counter[str]] = Counter()
    birds: ClassVar[list[Forging]] = []
    random = Random(7)

    def __init__(self, bird: int, *arguments: Any, **options: Any) -> None:
        super().__init__(bird, *arguments, **options)
        Forging.birds.append(self)
        self.names = [other for other in range(1, CONFIGURATION.birds + 1) if other != bird]
        self.forged = {
            other: self.create_publisher(BirdStage, topics.stage_topic(other), latched(1))
            for other in self.names
        }

    def drain(self) -> bool:
        if self.random.random() < 0.05 and 0 < self.protocol.step < CONFIGURATION.steps // 2:
            self.forge()
        return super().drain()

    def forge(self) -> None:
        """Say in the name of another bird what is wrong in one thing, and awaited but for that."""
        run_id, epoch = self.protocol._session.now
        step, number = divmod(self.protocol.tick, STAGES)
        other = self.random.choice(self.names)
        one = np.ones(CONFIGURATION.members)
        three, long = (one, one, one), (one, one, np.append(one, 1.0))
        out_of_reach = "for a step or stage that is over or too far ahead"
        reason, forgery = self.random.choice(
            [
                ("of another run", (run_id ^ 1, step, epoch, other, number, *three)),
                ("with a wrong length", (run_id, step, epoch, other, number, *long)),
                ("not from a neighbour", (run_id, step, epoch, 99, number, *three)),
                ("of an epoch that is over", (run_id, step, epoch - 1, other, number, *three)),
                (out_of_reach, (run_id, CONFIGURATION.steps, epoch, other, number, *three)),
                (out_of_reach, (run_id, 2**62 + step, epoch, other, number, *three)),
            ]
        )
        listeners = self.forged[other].get_subscription_count()
        self.sent[reason] += listeners
        self.forged[other].publish(Stage(*forgery).encode())


RUN = 7


def stage(bird: int, number: int, value: float = 1.0) -> bytes:
    """Return the stage `number` of the first step of a bird, with a value throughout."""
    values = np.full(CONFIGURATION.members, value)
    return Stage(RUN, 0, 1, bird, number, values, values, values).encode()


def begin(bird: BirdNode) -> None:
    """Let bird 2 take off by itself."""
    protocol, last = bird.protocol, CONFIGURATION.steps
    for other in (1, 3):
        protocol.receive_wing(Wing(RUN, other, CONFIGURATION.span_ratio[other - 1]))
    protocol.receive_grant(Grant(RUN, 0, last, 1.0, 1))
    protocol.receive_checkpoint(Checkpoint.of_start(RUN, 1))
    protocol.receive_grant(Grant(RUN, last, last, 1.0, 1))
    assert protocol.in_flight


def assert_flies_as_the_reference(kind: type[BirdNode]) -> None:
    Observed.outcomes.clear()
    flown = fly(bird=kind, **FLOCK)
    rows = list(Reference(CONFIGURATION).fly())
    assert len(rows) == len(flown.time)
    for name in ("position", "speed", "circulation"):
        expected = np.stack([getattr(row, name) for row in rows])
        assert flown[name].values.tobytes() == expected.tobytes(), name


def test_birds_fly_by_the_compiled_exchange() -> None:
    assert_flies_as_the_reference(Observed)
    assert Observed.outcomes[compiled_exchange.WAITS] > STAGES * CONFIGURATION.steps
    assert (
        Observed.outcomes[compiled_exchange.OVER] >= CONFIGURATION.birds * CONFIGURATION.steps // 10
    )
    assert Observed.outcomes.keys() <= {compiled_exchange.WAITS, compiled_exchange.OVER}


def test_a_bird_that_is_asked_in_flight_stays_on_the_fast_path() -> None:
    assert_flies_as_the_reference(Asked)
    assert Observed.outcomes[compiled_exchange.WAITS] > STAGES * CONFIGURATION.steps


@pytest.mark.parametrize("broken", [Mute, Deaf])
def test_what_compiled_code_cannot_do_is_left_to_rclpy(broken: type[Observed]) -> None:
    assert_flies_as_the_reference(broken)
    failure = compiled_exchange.UNSENT if broken is Mute else compiled_exchange.FAILED
    assert Observed.outcomes[failure] > 0


def test_where_ros_lacks_functions_birds_fly_without_the_exchange(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(compiled_exchange, "available", lambda: False)
    assert_flies_as_the_reference(Plain)


def test_forged_stages_are_counted_each_and_change_no_bit() -> None:
    Forging.birds.clear()
    Forging.sent.clear()
    assert_flies_as_the_reference(Forging)
    counted: Counter[str] = Counter()
    for bird in Forging.birds:
        counted += bird.protocol.ignored_for
    assert counted == Forging.sent
    assert min(counted.values()) > 5
    assert len(counted) == 5
    assert Observed.outcomes[compiled_exchange.STRANGE] > 0


def test_a_bird_that_waits_takes_all_messages_of_the_neighbours_that_have_spoken() -> None:
    one, flood = np.ones(CONFIGURATION.members), 300
    with ros_alone() as context, executing("single", context) as executor:
        bird = BirdNode(2, CONFIGURATION, RUN, context=context)
        executor.add_node(bird)
        said = bird.create_publisher(BirdStage, topics.stage_topic(1), latched(1000))
        deadline = time.monotonic() + 60.0
        while said.get_subscription_count() < 1:
            assert time.monotonic() < deadline, "the bird is not found"
            time.sleep(0.01)
        begin(bird)
        for data in (stage(1, 0), stage(3, 0)):
            bird._send(bird.protocol.receive_stage(data))
        assert bird.protocol.step == 0
        for value in (1.0, 2.0):
            said.publish(stage(1, 1, value))  # and bird 3 says nothing
        for _ in range(flood):
            said.publish(Stage(RUN + 1, 0, 1, 1, 1, one, one, one).encode())
        while bird.protocol.ignored < flood + 1:
            assert time.monotonic() < deadline, bird.protocol.ignored_for
            bird.drain()
            bird.drain_rare()
        assert bird.protocol.ignored_for == {"of another run": flood, AGAIN: 1}
        # Messages of any other size come too: one look takes all that have arrived.
        long = np.append(one, 1.0)
        for _ in range(flood):
            said.publish(Stage(RUN + 1, 0, 1, 1, 1, long, long, long).encode())
        looks = 0
        while bird.protocol.ignored < 2 * flood + 1:
            assert time.monotonic() < deadline, bird.protocol.ignored_for
            before = bird.protocol.ignored
            bird.drain_rare()
            looks += bird.protocol.ignored > before
        assert looks < flood // 10
        assert bird.protocol.missing == [3]
        assert stage_numbers(bird.protocol._inbox.heard[1, 0], 2)[0].tolist() == [1.0, 1.0]

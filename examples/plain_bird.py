# SPDX-License-Identifier: Apache-2.0
"""A bird in plain rclpy, without code of Flock: a pattern for a bird in another language.

    ./flock python examples/plain_bird.py 2

It flies as bird 2 of a flock whose other nodes run by hand. It supports nearest-neighbour coupling
of standard birds over exact links, without forcing or pushes. The numbers in the comments are those
of the steps in docs/ros.md, "A bird in another language".
"""

from __future__ import annotations

import json
import math
import random
import sys
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from flock_interfaces.msg import BirdStage, BirdState, BirdWing, Checkpoint, Grant, Progress

NODES = (0.0, 0.5, 0.5, 1.0)
"""Times of the stages of RK4, in steps."""

WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def latched(depth: int) -> QoSProfile:
    """Return the quality of service of all topics of a flock; depth 0 keeps all messages."""
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        history=HistoryPolicy.KEEP_LAST if depth else HistoryPolicy.KEEP_ALL,
        depth=depth,
    )


class Body:
    """The physics of a standard bird (docs/model.md), in units of b, U_min and rho."""

    def __init__(self, terms: dict[str, Any]) -> None:
        """Take the configuration that the clock sends with its grants."""
        half = 0.5 * terms["wing_span"]  # b, in m
        self.second = half / terms["min_drag_speed"]
        self.mass = terms["body_mass"] / (terms["air_density"] * half**3)
        self.cruise = terms["cruise_speed"] / terms["min_drag_speed"]
        self.k = 2 * terms["zero_lift_drag"] / terms["aspect_ratio"]
        lift = terms["oswald_efficiency"] * terms["zero_lift_drag"]
        self.circulation = 4 * math.sqrt(lift / (math.pi * terms["aspect_ratio"]))
        self.thrust = self.drag(self.cruise)
        self.gap = 2 + math.pi / 4 - 1  # lateral distance of neighbours

    def drag(self, speed: float) -> float:
        """Return the drag of the bird alone."""
        return self.k * (speed**2 + speed**-2)

    def interaction(self, ahead: float, own: float, other: float) -> float:
        """Return the drag caused by a neighbour that is `ahead`; both circulations are given."""
        share = self._share(abs(ahead))
        if ahead > 0:
            share = 2 * self._share(0.0) - share
        return own * other / (4 * math.pi) * share

    def _share(self, x: float) -> float:
        a = math.pi / 4
        p, q, s = self.gap + 2 * a, self.gap, self.gap - 2 * a
        if x < 1e-6:
            return math.log(p * s / (q * q))
        jp, jq, js = (math.hypot(x, u) for u in (p, q, s))
        return math.log((x + jp) * (x + js) / (x + jq) ** 2) - (jp + js - 2 * jq) / x


class PlainBird(Node):
    """One bird of a flock."""

    def __init__(self, bird: int) -> None:
        """Put bird 1..N on its topics. The names are relative, so `-r __ns:=` moves them."""
        super().__init__(f"bird_{bird:02d}", namespace="/flock")
        self.bird = bird
        self.done = False
        self.run = self.epoch = None
        self.checkpoint: Checkpoint | None = None
        self.granted = self.end = self.reported = -1
        self.flying = False
        self.life = random.getrandbits(64)
        self.heard: dict[tuple[int, int, int, int], BirdStage] = {}
        self.last: list[BirdStage] = []
        self.repeated: object = None
        name = self.get_name()
        self.wings = self.create_publisher(BirdWing, f"{name}/wing", latched(1))
        self.stages = self.create_publisher(BirdStage, f"{name}/stage", latched(128))
        self.states = self.create_publisher(BirdState, f"{name}/state", latched(1024))
        self.progress = self.create_publisher(Progress, "progress", latched(1))
        self.create_subscription(Grant, "clock/grant", self.hear_grant, latched(0))
        self.create_subscription(Checkpoint, "checkpoint", self.hear_checkpoint, latched(0))
        self.create_timer(1.0, self.repeat)

    def hear_grant(self, grant: Grant) -> None:
        """Join the flight (1), begin an epoch (2), go on (6), or end (8)."""
        if self.run is None:
            self.join(grant)
        if grant.run_id != self.run:
            return
        if grant.epoch != self.epoch:
            self.epoch, self.flying, self.last = grant.epoch, False, []
            self.heard = {key: stage for key, stage in self.heard.items() if key[0] == self.epoch}
            self.report(-1)
        self.granted, self.end = grant.step, grant.end
        self.done = grant.step > grant.end
        self.begin()
        self.go_on()

    def join(self, grant: Grant) -> None:
        """Take run id and configuration, tell the span, and listen to the neighbours."""
        self.run, self.terms = grant.run_id, json.loads(grant.terms)
        plain = {
            "coupling": "nearest",
            "span_ratios": [],
            "links": [],
            "forcing": [],
            "perturbations": [],
        }
        for key, value in plain.items():
            if self.terms[key] != value:
                sys.exit(f"error: {key} = {self.terms[key]}: this bird supports {value} only")
        self.body = Body(self.terms)
        birds = self.terms["birds"]
        self.neighbours = [i for i in (self.bird - 1, self.bird + 1) if 1 <= i <= birds]
        self.wings.publish(BirdWing(run_id=self.run, bird=self.bird, span_ratio=[1.0]))
        for other in self.neighbours:
            topic = f"bird_{other:02d}/stage"
            self.create_subscription(BirdStage, topic, self.hear_stage, latched(0))

    def hear_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep the last checkpoint: it may come before the grant of its epoch (3)."""
        self.checkpoint = checkpoint
        self.begin()
        self.go_on()

    def begin(self) -> None:
        """Begin to fly at the checkpoint of this epoch (3)."""
        at = self.checkpoint
        if self.flying or at is None or (at.run_id, at.epoch) != (self.run, self.epoch):
            return
        self.flying, self.step = True, at.step
        if at.position:
            self.x, self.u = at.position[self.bird - 1], at.speed[self.bird - 1]
        else:
            leader = self.terms["birds"] // 2 + 1
            self.x = -abs(self.bird - leader) * self.body.gap
            self.u = self.body.cruise
        self.begin_step()

    def begin_step(self) -> None:
        """Begin a step with stage 0."""
        self.stage, self.slopes, self.told = 0, [], False
        self.say(self.x, self.u)

    def say(self, x: float, u: float) -> None:
        """Send the values of a stage (4)."""
        self.now = x, u
        message = BirdStage(run_id=self.run, step=self.step, epoch=self.epoch, bird=self.bird)
        message.stage = self.stage
        message.position, message.speed = [x], [u]
        message.circulation = [self.body.circulation / u]
        self.stages.publish(message)
        self.last = [*self.last[-1:], message]

    def hear_stage(self, stage: BirdStage) -> None:
        """Keep a stage until it is needed."""
        if stage.run_id == self.run:
            self.heard[stage.epoch, stage.step, stage.stage, stage.bird] = stage
            self.go_on()

    def go_on(self) -> None:
        """Compute stage after stage, as far as messages and grant allow."""
        while self.flying:
            keys = [(self.epoch, self.step, self.stage, other) for other in self.neighbours]
            if not all(key in self.heard for key in keys):
                return
            x, u = self.now
            own, drag = self.body.circulation / u, 0.0
            for key in keys:  # in the order of the birds' numbers
                other = self.heard[key]
                ahead = other.position[0] - x
                drag += self.body.interaction(ahead, own, other.circulation[0])
            if self.stage == 0 and not self.told:
                self.tell(own, drag)
            if self.stage == 0 and self.step >= min(self.granted, self.end):
                return
            for key in keys:
                del self.heard[key]
            force = self.body.thrust - self.body.drag(u) - drag
            self.slopes.append((u, force / self.body.mass))
            self.advance()

    def advance(self) -> None:
        """Go to the next stage, or to the next step."""
        dt = self.terms["dt"]
        self.stage += 1
        if self.stage < 4:
            along, faster = (NODES[self.stage] * dt * slope for slope in self.slopes[-1])
            self.say(self.x + along, self.u + faster)
            return
        self.x += dt * sum(w * slope[0] for w, slope in zip(WEIGHTS, self.slopes, strict=True))
        self.u += dt * sum(w * slope[1] for w, slope in zip(WEIGHTS, self.slopes, strict=True))
        self.step += 1
        self.begin_step()

    def tell(self, circulation: float, drag: float) -> None:
        """Send the state of a recorded step (5), and report the step (6)."""
        self.told = True
        if self.step % self.terms["record_every"] == 0:
            state = BirdState(step=self.step, run_id=self.run, epoch=self.epoch)
            state.time = self.step * self.terms["dt"]
            stamp = divmod(round(state.time * self.body.second * 1e9), 10**9)
            state.header.frame_id = "world"
            state.header.stamp.sec, state.header.stamp.nanosec = stamp
            state.position, state.speed = [self.x], [self.u]
            state.circulation, state.interaction_drag = [circulation], [drag]
            self.states.publish(state)
        half = self.step - self.reported >= self.granted - self.step
        if self.reported < 0 or half or self.step >= self.granted:
            self.report(self.step)

    def report(self, step: int) -> None:
        """Report the step reached to the clock; -1: present, and nothing heard yet."""
        self.reported = step
        message = Progress(run_id=self.run, step=step, epoch=self.epoch, life=self.life)
        message.who = self.get_name()
        self.progress.publish(message)

    def repeat(self) -> None:
        """Repeat the last messages if nothing has come for a second (7)."""
        if self.run is None:
            return
        now = (self.epoch, self.step, self.stage) if self.flying else self.epoch
        if now == self.repeated:
            for stage in self.last:
                self.stages.publish(stage)
            self.report(self.reported)
        self.repeated = now


def main() -> None:
    """Fly until the clock ends the flight."""
    rclpy.init()
    bird = PlainBird(int(rclpy.utilities.remove_ros_args(sys.argv)[1]))
    while not bird.done:
        rclpy.spin_once(bird, timeout_sec=0.5)
    print(f"{bird.get_name()} has reached step {bird.step}")
    bird.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()

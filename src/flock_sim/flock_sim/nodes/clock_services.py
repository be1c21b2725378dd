# SPDX-License-Identifier: Apache-2.0
"""The services that control a flight: pause, resume, step, stop and perturb."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

from rclpy.node import Node
from std_srvs.srv import Trigger

from flock_interfaces.srv import Perturb, Step
from flock_sim.errors import FlockError
from flock_sim.protocol.clock import Message, Timekeeper

Response = TypeVar("Response", Trigger.Response, Step.Response, Perturb.Response)


class Control:
    """Serves the clock's services `~/pause ~/resume ~/step ~/stop ~/perturb`."""

    def __init__(
        self, node: Node, keeper: Timekeeper, send: Callable[[Iterable[Message]], None]
    ) -> None:
        """Offer the services on `node`; `send` publishes the messages that the keeper returns."""
        self._keeper = keeper
        self._send = send
        self._logger = node.get_logger()
        for kind, name, serve in (
            (Trigger, "pause", self._pause),
            (Trigger, "resume", self._resume),
            (Trigger, "stop", self._stop),
            (Step, "step", self._step),
            (Perturb, "perturb", self._perturb),
        ):
            node.create_service(kind, f"~/{name}", _refuse if keeper.free else serve)

    def _pause(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._keeper.pause()
        return self._said(response, self._pausing())

    def _resume(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._send(self._keeper.resume())
        return self._said(response, "the flight continues")

    def _stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._send(self._keeper.stop())
        keeper = self._keeper
        where = f"at step {keeper.end}" if keeper.begun else "when all nodes are present"
        return self._said(response, f"the flight ends {where}")

    def _step(self, request: Step.Request, response: Step.Response) -> Step.Response:
        if request.steps < 1:
            return self._said(response, "steps = 0: must be 1 or more", success=False)
        self._send(self._keeper.take_steps(request.steps))
        return self._said(response, self._pausing())

    def _pausing(self) -> str:
        keeper = self._keeper
        if keeper.leave_known:
            return f"the flight pauses at step {keeper.pauses_at}"
        after = f"{keeper.pausing.steps} steps after" if keeper.pausing.steps else "at"
        return f"the flight pauses {after} the step at which it begins or continues"

    def _perturb(self, request: Perturb.Request, response: Perturb.Response) -> Perturb.Response:
        try:
            step, outgoing = self._keeper.perturb(
                request.bird, request.member, request.step, request.position, request.speed
            )
        except FlockError as error:
            return self._said(response, str(error), success=False)
        self._send(outgoing)
        response.step = step
        return self._said(response, f"bird {request.bird} is pushed at step {step}")

    def _said(self, response: Response, message: str, *, success: bool = True) -> Response:
        self._logger.info(message if success else f"request refused: {message}")
        return _said(response, message, success=success)


def _refuse(_: object, response: Response) -> Response:
    return _said(
        response,
        "a free flight can't be paused, stepped or perturbed; Ctrl-C ends it",
        success=False,
    )


def _said(response: Response, message: str, *, success: bool = True) -> Response:
    response.success, response.message = success, message
    return response

# SPDX-License-Identifier: Apache-2.0
"""A clock ends itself when another one leads its flock, even if it hears of that one late."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import pytest
from rclpy.context import Context

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.types import Progress
from flock_sim.nodes import clock as clock_module
from flock_sim.nodes.clock import RIVAL_SILENCE, ClockNode
from flock_sim.protocol.clock import Timekeeper

RUN, EPOCH = 7, 5


@contextmanager
def clock_of_flock(context: Context, step: int) -> Iterator[ClockNode]:
    """Give a clock to which a flock has reported that it is at `step`, and all of it on disk."""
    configuration = FlockConfiguration(birds=2, t_max=1000.0, record_every=5)
    keeper = Timekeeper(configuration, RUN, window=4, record=True, epoch=EPOCH)
    clock = ClockNode(keeper, 10, context=context)
    try:
        clock.look_around()
        for who in ("recorder", "bird_01", "bird_02"):
            clock._hear(Progress(RUN, step, EPOCH, who).encode())
        assert keeper.begun
        clock.look_around()
        yield clock
    finally:
        clock.destroy_node()


def hear_rival(clock: ClockNode, times: int = 2) -> None:
    """Let the clock hear grants of another one, which goes beyond the epochs of this one."""
    for _ in range(times):
        grant = clock.keeper.grant
        clock._hear_another(replace(grant, epoch=grant.epoch + 100).encode())


def test_a_clock_that_hears_of_the_leading_one_after_the_flock_ends_itself(
    context: Context,
) -> None:
    with clock_of_flock(context, 690) as clock:
        hear_rival(clock)
        with pytest.raises(FlockError, match="another clock controls run 7: end it first"):
            clock.look_around()


def test_the_clock_that_a_flock_has_begun_with_does_not_end_itself(context: Context) -> None:
    with clock_of_flock(context, 0) as clock:
        hear_rival(clock)
        clock.look_around()


def test_a_clock_that_replaces_another_one_leads_once_that_one_is_silent(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1000.0
    monkeypatch.setattr(clock_module, "time", SimpleNamespace(monotonic=lambda: now))
    with clock_of_flock(context, 690) as clock:
        hear_rival(clock, times=1)  # its last one
        now = math.nextafter(1000.0 + RIVAL_SILENCE, math.inf)
        clock.look_around()
        hear_rival(clock)
        clock.look_around()

# SPDX-License-Identifier: Apache-2.0
"""Well-formed forged messages, even of the flight's own run, do not end a flight or spoil its bag.

FLOCK_FORGERIES=N forges N messages instead of a few.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from random import Random
from typing import Any

import pytest

from flock_interfaces.msg import Checkpoint, Grant, Perturbation, Progress
from flock_sim.messages import topics
from flock_sim.recording.run import Run
from flock_sim.ros.endpoints import latched
from support.bags import assert_stopped_as_the_reference, last_step
from support.forgeries import KINDS, forgeries
from support.terminal import Job, Terminal
from support.visitor import Visitor

COUNT = int(os.environ.get("FLOCK_FORGERIES", str(2 * len(KINDS))))
"""Messages that are forged in all."""

EACH = 2 * len(KINDS)
"""Messages that are forged in one flight."""

TYPES: dict[str, Any] = {
    topics.GRANT_TOPIC: Grant,
    topics.CHECKPOINT_TOPIC: Checkpoint,
    topics.PERTURBATION_TOPIC: Perturbation,
    topics.PROGRESS_TOPIC: Progress,
}
HEARD = (topics.GRANT_TOPIC, topics.PROGRESS_TOPIC)


class Genuine(Mapping[str, bytes]):
    """The last message of each topic that this test has not sent itself."""

    def __init__(self, heard: dict[str, list[bytes]], sent: set[bytes]) -> None:
        self._heard = heard
        self._sent = sent

    def __getitem__(self, topic: str) -> bytes:
        return next(data for data in reversed(self._heard[topic]) if data not in self._sent)

    def __iter__(self) -> Iterator[str]:
        return iter(self._heard)

    def __len__(self) -> int:
        return len(self._heard)


def flies_on(job: Job, name: str, bag: Path, step: int) -> bool:
    """Whether more than `step` is on disk; the flight must not have ended."""
    assert job.running, f"{name}: {job.stderr}"
    return last_step(bag) > step


@pytest.mark.parametrize("seed", range(-(-COUNT // EACH)))
@pytest.mark.slow
def test_a_flight_survives_any_message_of_its_own_run(
    terminal: Terminal, visitor: Visitor, seed: int
) -> None:
    flock = ("--birds", 3, "--t-max", 1e8, "--record-every", 10, "--span-ratio", "2=0.97,1.03")
    heard = {topic: visitor.hear(TYPES[topic], topic, raw=True, depth=1) for topic in HEARD}
    outlets = {
        topic: visitor.node.create_publisher(kind, topic, latched(1))
        for topic, kind in TYPES.items()
    }
    how = ("--processes", 3, "--timeout", 20, "--output", "bag")
    job = terminal.start("fly", *flock, *how)
    bag = terminal.directory / "bag"
    visitor.until(lambda: all(heard.values()) and last_step(bag) > 0)
    visitor.until(lambda: all(outlet.get_subscription_count() > 0 for outlet in outlets.values()))
    sent: set[bytes] = set()
    for name, topic, data in islice(forgeries(Random(seed), Genuine(heard, sent)), EACH):
        before = last_step(bag)
        sent.add(data)
        outlets[topic].publish(data)
        visitor.until(lambda before=before, name=name: flies_on(job, name, bag, before))
    visitor.stop(job)
    with Run(bag) as run:
        assert run.perturbations() == []
    assert_stopped_as_the_reference(terminal, 3, 10, *flock)

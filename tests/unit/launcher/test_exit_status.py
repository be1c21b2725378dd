# SPDX-License-Identifier: Apache-2.0
"""The exit status of a process decides whether it is restarted, under `fly` and `ros2 launch`."""

import signal

import pytest

from flock_sim.console.arguments import FAULT
from flock_sim.errors import FlockError, RunFailed
from flock_sim.launcher.exit_status import WHY, ended, failed


@pytest.mark.parametrize(
    ("status", "told"),
    [
        (0, "ended before the flight was over"),
        (-signal.SIGKILL, "was killed by SIGKILL"),
        (-signal.SIGSEGV, "was killed by SIGSEGV"),
        (-40, "was killed by signal 40"),
        (128 + signal.SIGTERM, "ended with status 143"),
    ],
)
def test_a_process_that_was_killed_or_ended_early_may_be_restarted(status: int, told: str) -> None:
    assert not failed(status)
    assert ended(status) == told


@pytest.mark.parametrize("status", [1, 2, 3, 70, 127])
def test_a_process_that_failed_would_fail_again(status: int) -> None:
    assert failed(status)
    assert ended(status) == f"ended with status {status}"


def test_every_error_of_flock_has_a_reason() -> None:
    assert WHY.keys() == {RunFailed.exit_status, FlockError.exit_status, FAULT}

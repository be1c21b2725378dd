# SPDX-License-Identifier: Apache-2.0
"""The terminals of the tests know their own processes from those of others."""

from __future__ import annotations

import os

import pytest

from support.terminal import Terminal


def test_the_number_of_an_ended_session_may_go_to_the_process_of_another_test(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = terminal.start("limits", "--birds", 3)
    job.wait()
    assert not terminal.processes()
    monkeypatch.setattr(os, "getsid", lambda pid: job.process.pid)
    assert not terminal.processes()


def test_a_process_that_has_not_begun_its_session_yet_is_known_once_it_has(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = terminal.start("clock", "--ros-args", "-p", "birds:=3")
    with monkeypatch.context() as early:
        early.setattr(os, "getsid", lambda pid: os.getpid())
        terminal.processes()
    job.until_connected()
    assert job.process.pid in terminal.processes()
    job.interrupt()
    assert job.wait().status == 130

# SPDX-License-Identifier: Apache-2.0
"""The table of `watch` shows what it has received, and nothing in it controls the terminal."""

from __future__ import annotations

from rich.console import Console

from flock_tools.commands.watch import table
from flock_tools.live.flock_monitor import Sample


def sample() -> Sample:
    return Sample(
        birds=1,
        members=1,
        member=1,
        leader=1,
        step=5,
        time=5.0,
        end=None,
        coupling=None,
        real_time_factor=None,
        rate=None,
        position=[0.0],
        speed=[1.0],
        speed_std=0.0,
        interaction_drag=[0.0],
        drag_reduction=None,
        age=[0.0],
        hears=None,
    )


def test_the_reason_why_a_configuration_is_unreadable_is_shown_as_it_is() -> None:
    console = Console(width=300, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(table(sample(), "links = ['[/x]\x1b]0;x\x07']"))
    assert r"can't be read (links = ['[/x]\x1b]0;x\x07'])" in " ".join(
        console.export_text().split()
    )

# SPDX-License-Identifier: Apache-2.0
"""`make bench`: flights against bare relays, recording and the reference, in one run.

All are run in turn, round after round, so that a noisy machine troubles all alike; the table
gives the median over the rounds and the ratios of medians.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.partition import partition
from flock_sim.reference.integrator import Reference

BIRDS = 13
RELAY = Path(__file__).with_name("relay.py")
LIMIT = 600.0  # s, for any one measurement


def relay(kind: str, processes: int, steps: int, birds: int = BIRDS) -> float:
    """Return the steps per second of a bare relay."""
    command = [sys.executable, "-P", str(RELAY), kind, str(birds), str(steps)]
    started = [
        subprocess.Popen(
            [*command, str(share[0]), str(share[-1])], stdout=subprocess.PIPE, text=True
        )
        for share in partition(birds, processes)
    ]
    times = [process.communicate(timeout=LIMIT)[0].split() for process in started]
    begun = min(float(first) for first, _ in times)
    ended = max(float(last) for _, last in times)
    return steps / (ended - begun)


def fly(processes: int, steps: int, *options: str, birds: int = BIRDS) -> float:
    """Return the steps per second of a flight."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "flock_sim.commands.fly",
        "--json",
        "--t-max",
        str(steps),
    ]
    command += ["--birds", str(birds), "--processes", str(processes), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=True)
    return float(json.loads(done.stdout)["steps_per_second"])


def recorded(processes: int, steps: int) -> float:
    """Return the steps per second of a flight of which every 10th step is recorded."""
    with tempfile.TemporaryDirectory() as directory:
        output = Path(directory) / "bag"
        return fly(processes, steps, "--output", str(output))


def reference(steps: int) -> float:
    """Return the steps per second of the reference's loop, every 10th step kept."""
    flock = Reference(FlockConfiguration(birds=BIRDS, t_max=float(steps)))
    begun = time.perf_counter()
    flock.advance(steps)
    return steps / (time.perf_counter() - begun)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=4000)
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "101")
    steps = options.steps

    reference(1000)  # compiled, and the processor awake
    measurements: dict[str, Callable[[], float]] = {}
    for processes in (1, 2):
        where = f"{processes} process" + "es" * (processes > 1)
        measurements |= {
            f"relay, events executor, {where}": lambda p=processes: relay("events", p, steps),
            f"relay, direct, {where}": lambda p=processes: relay("direct", p, steps),
            f"fly, {where}": lambda p=processes: fly(p, steps, "--no-record"),
            f"fly, recorded, {where}": lambda p=processes: recorded(p, steps),
        }
    measurements["reference"] = lambda: reference(100 * steps)

    rates: dict[str, list[float]] = {name: [] for name in measurements}
    with Console(stderr=True).status("") as status:
        for count in range(options.rounds):
            for name, measure in measurements.items():
                status.update(f"round {count + 1} of {options.rounds}: {name}")
                rates[name].append(measure())

    table = Table(title=f"{BIRDS} birds, steps/s, median of {options.rounds} rounds")
    for column in ("what", "steps/s", "of the events relay", "of the direct relay", "of fly"):
        table.add_column(column, justify="left" if column == "what" else "right")
    middle = {name: median(values) for name, values in rates.items()}
    for name, rate in middle.items():
        where = name.rpartition(", ")[2]
        others = [f"relay, events executor, {where}", f"relay, direct, {where}", f"fly, {where}"]
        ratios = [f"{rate / middle[o]:.2f}" if o in middle and o != name else "" for o in others]
        table.add_row(name, f"{rate:,.0f}", *ratios)
    console = Console(width=100)
    console.print(table)
    console.print(f"reference: {1e6 / middle['reference']:.2f} us a step")


if __name__ == "__main__":
    main()

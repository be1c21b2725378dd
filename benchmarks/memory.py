# SPDX-License-Identifier: Apache-2.0
"""Does a long flight stay flat in memory? Samples every process of one, and compares its halves.

    ./flock python benchmarks/memory.py [--steps 100000] [--processes 1]

Exit status 1 if the second half's mean resident memory is more than 2 % above the first half's.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import mean

from rich.console import Console
from rich.table import Table

PAGE = os.sysconf("SC_PAGE_SIZE")
ALLOWED = 1.02
WARM_UP = 8.0  # s, in which the processes start


def children(parent: int) -> list[int]:
    """Return the processes that `parent` has started."""
    tasks = Path(f"/proc/{parent}/task/{parent}/children").read_text(encoding="ascii")
    return [int(word) for word in tasks.split()]


def resident(process: int) -> float:
    """Return the resident memory of a process, in MiB."""
    return int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1]) * PAGE / 2**20


def name(process: int) -> str:
    """Return what a process of a flight is, in a word or two."""
    words = Path(f"/proc/{process}/cmdline").read_text(encoding="utf-8").split("\0")
    module = next((word for word in words if word.startswith("flock_sim.")), "?")
    return module.removeprefix("flock_sim.").removeprefix("nodes.")


def main() -> int:
    """Fly, sample, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    samples: dict[int, list[float]] = {}
    names: dict[int, str] = {}
    with tempfile.TemporaryDirectory() as directory:
        command = [
            sys.executable,
            "-P",
            "-m",
            "flock_sim.commands.fly",
            "--t-max",
            str(options.steps),
        ]
        command += ["--processes", str(options.processes), "--output", f"{directory}/bag"]
        flight = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        began = time.monotonic()
        while flight.poll() is None:
            time.sleep(0.5)
            if time.monotonic() - began < WARM_UP:
                continue
            try:
                for process in [flight.pid, *children(flight.pid)]:
                    names.setdefault(process, name(process))
                    samples.setdefault(process, []).append(resident(process))
            except FileNotFoundError:
                break  # the flight is ending
        flight.wait()

    table = Table(title=f"resident memory over {options.steps:,} steps, MiB")
    for column in ("process", "first half", "second half", "ratio"):
        table.add_column(column, justify="left" if column == "process" else "right")
    worst = 0.0
    for process, values in samples.items():
        half = len(values) // 2
        first, second = mean(values[:half]), mean(values[half:])
        worst = max(worst, second / first)
        table.add_row(names[process], f"{first:.1f}", f"{second:.1f}", f"{second / first:.4f}")
    Console().print(table)
    return int(flight.returncode != 0 or worst > ALLOWED)


if __name__ == "__main__":
    sys.exit(main())

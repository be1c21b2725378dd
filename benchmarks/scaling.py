# SPDX-License-Identifier: Apache-2.0
"""How flocks of many birds fly: rate against the bare relay, start, memory and discovery.

All are run in turn, round after round, as in run.py; the table gives medians. Memory is the
proportional set size of the birds' processes; discovery is what goes over the loopback device until
the end of a flight of one step.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table
from run import LIMIT, relay

STEPS = {1: 1000, 13: 3000, 101: 500, 501: 100}
LAYOUTS = ((13, 1), (13, 2), (13, 13), (101, 1), (101, 2), (501, 1), (501, 2))
"""Birds and processes. With a process a bird, many share few cores, so that a tenth of the steps
takes as long."""


@dataclass
class Measured:
    """What was measured of one flock in one layout, round by round."""

    relay: list[float] = field(default_factory=list)  # steps/s
    fly: list[float] = field(default_factory=list)  # steps/s
    start: list[float] = field(default_factory=list)  # s, from the command to the first step
    memory: list[float] = field(default_factory=list)  # bytes, of all processes of birds


def fly(birds: int, processes: int, steps: int, measured: Measured) -> None:
    """Fly without a bag; note rate, start and memory."""
    command = [sys.executable, "-P", "-m", "flock_sim.commands.fly", "--json", "--no-record"]
    command += ["--birds", str(birds), "--processes", str(processes), "--t-max", str(steps)]
    begun = time.monotonic()
    flight = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    most = 0.0
    while flight.poll() is None:
        most = max(most, sum(memory(pid) for pid in birds_of(flight.pid)))
        time.sleep(0.2)
    told = json.loads(flight.communicate(timeout=LIMIT)[0])
    before = time.monotonic() - begun - told["wall_seconds"]  # Python, imports; and the end
    measured.fly.append(told["steps_per_second"])
    measured.start.append(told["start_seconds"] + before)
    measured.memory.append(most)


def birds_of(parent: int) -> list[int]:
    """Return the processes of birds that `parent` has started."""
    try:
        children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    except OSError:
        return []
    return [int(child) for child in children if b"nodes.bird" in read(f"/proc/{child}/cmdline")]


def memory(pid: int) -> float:
    """Return the proportional set size of a process, in bytes; 0 if it is gone."""
    for line in read(f"/proc/{pid}/smaps_rollup").splitlines():
        if line.startswith(b"Pss:"):
            return 1024.0 * float(line.split()[1])
    return 0.0


def read(file: str) -> bytes:
    """Return what is in `file`; nothing if its process is gone."""
    try:
        return Path(file).read_bytes()
    except OSError:
        return b""


def discovery(birds: int, processes: int) -> tuple[int, int]:
    """Return bytes and packets over the loopback device in a flight of one step."""
    command = [sys.executable, "-P", "-m", "flock_sim.commands.fly", "--json", "--no-record"]
    command += ["--birds", str(birds), "--processes", str(processes), "--t-max", "1"]
    before = loopback()
    subprocess.run(command, stdout=subprocess.DEVNULL, timeout=LIMIT, check=True)
    after = loopback()
    return after[0] - before[0], after[1] - before[1]


def loopback() -> tuple[int, int]:
    """Return the bytes and packets that the loopback device has received."""
    for line in Path("/proc/net/dev").read_text().splitlines():
        name, _, counts = line.partition(":")
        if name.strip() == "lo":
            received = counts.split()
            return int(received[0]), int(received[1])
    raise SystemExit("this machine has no loopback device")


def layout(words: str) -> tuple[int, int]:
    """Return birds and processes of, say, "13x2"."""
    birds, _, processes = words.partition("x")
    return int(birds), int(processes)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--layouts", type=layout, nargs="+", default=LAYOUTS, metavar="BIRDSxPROCESSES"
    )
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "101")
    layouts = [(1, 1), *options.layouts]
    results = {flown: Measured() for flown in layouts}
    with Console(stderr=True).status("") as status:
        for count in range(options.rounds):
            for (birds, processes), measured in results.items():
                status.update(f"round {count + 1}: {birds} birds in {processes}")
                steps = STEPS.get(birds, max(50, 50000 // birds))
                if birds == processes > 1:
                    steps //= 10
                if birds > 1:
                    measured.relay.append(relay("direct", processes, steps, birds))
                fly(birds, processes, steps, measured)
                if birds > 1:
                    rate, bare = measured.fly[-1], measured.relay[-1]
                    print(
                        f"{birds} birds in {processes}: relay {bare:,.1f}, fly {rate:,.1f} "
                        f"steps/s, ratio {rate / bare:.2f}, start {measured.start[-1]:.1f} s",
                        file=sys.stderr,
                    )
        traffic = {flown: discovery(*flown) for flown in layouts if flown[0] > 1}

    alone = median(results[1, 1].memory)
    table = Table(title=f"median of {options.rounds} rounds")
    for column in (
        *("birds", "processes", "relay, steps/s", "fly, steps/s", "ratio", "start, s"),
        *("MB a bird beyond the first", "discovery, MB", "packets"),
    ):
        table.add_column(column, justify="right")
    for (birds, processes), measured in results.items():
        if birds == 1:
            continue
        rate, bare = median(measured.fly), median(measured.relay)
        more = (median(measured.memory) - processes * alone) / max(1, birds - processes)
        sent, packets = traffic[birds, processes]
        table.add_row(
            *(str(birds), str(processes), f"{bare:,.0f}", f"{rate:,.1f}", f"{rate / bare:.2f}"),
            *(f"{median(measured.start):.1f}", f"{more / 1e6:.2f}"),
            *(f"{sent / 1e6:.1f}", f"{packets:,}"),
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()

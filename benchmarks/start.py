# SPDX-License-Identifier: Apache-2.0
"""How soon tools answer and flights take their first step, and what goes on until then.

    ./flock python benchmarks/start.py [--rounds 5] [--layouts 13x1 101x2] [--only tools]

Times are compared with that of `import rclpy, numba`, which any process with a node and a kernel
needs: compare ratios, since times depend on the machine and on what else it does. All are run in
turn, round after round, and tables give medians.

- tools: --help of each, and those that answer at once.
- flights: ten steps without a bag, from the command to the first step and to the end.
- phases: what one process does until the first step of its birds (phases.py), and what its imports
  consist of.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table
from run import LIMIT
from scaling import layout

FLOCK = Path(__file__).parents[1] / "flock"
YARDSTICK = "import rclpy, numba"
WITH_HELP = (
    *("fly", "reference", "metrics", "compare", "picture", "report", "repair", "equilibrium"),
    *("limits", "arrange", "survey", "sweep", "figures", "study", "play", "watch", "view"),
    *("bird", "clock", "recorder"),
)
LAYOUTS = ((13, 1), (13, 13), (101, 2), (501, 2))
"""Birds and processes."""

PARTS = ("tools", "flights", "phases")
MOST_PACKAGES = 12
"""Packages that are listed, those that take longest to import."""

IMPORT = re.compile(r"import time: +(\d+) \| +\d+ \| +(\w+)")
BIRD = "import flock_sim.nodes.bird_process"


@dataclass
class Taken:
    """How long something took, round by round, in s."""

    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    """The time of its processes on the processors; empty where it is not measured."""


Results = dict[str, Taken]


def take(command: list[str], taken: Taken) -> bytes:
    """Run a command to its end, note its times, and return what it printed."""
    before = processor_time()
    begun = time.monotonic()
    done = subprocess.run(command, capture_output=True, timeout=LIMIT, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stderr.decode()}")
    taken.wall.append(time.monotonic() - begun)
    taken.processor.append(processor_time() - before)
    return done.stdout


def processor_time() -> float:
    """Return the time on the processors of all processes started here that have ended, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def tools(run: Path) -> dict[str, list[str]]:
    """Return commands by what they are called; `run` is a recorded flight."""
    answers = {
        "./flock --help": ["--help"],
        "metrics RUN": ["metrics", str(run)],
        "compare RUN RUN": ["compare", str(run), str(run)],
        "limits": ["limits"],
        "equilibrium": ["equilibrium"],
    }
    helps = {f"{tool} --help": [tool, "--help"] for tool in WITH_HELP}
    return {name: [str(FLOCK), *words] for name, words in (answers | helps).items()}


def fly(birds: int, processes: int, first: Taken, end: Taken) -> None:
    """Fly ten steps without a bag; note the time to the first of them and to the end."""
    command = [str(FLOCK), "fly", "--json", "--no-record", "--t-max", "10"]
    command += ["--birds", str(birds), "--processes", str(processes)]
    told = json.loads(take(command, end))
    before = end.wall[-1] - told["wall_seconds"]  # Python, imports; and the end
    first.wall.append(told["start_seconds"] + before)


def phases(birds: int, results: Results) -> None:
    """Note the phases of one process."""
    command = [str(FLOCK), "python", str(Path(__file__).with_name("phases.py")), str(birds)]
    done = subprocess.run(
        [*command, repr(time.time())], stdout=subprocess.PIPE, timeout=LIMIT, check=True
    )
    for name, (wall, processor) in json.loads(done.stdout).items():
        taken = results.setdefault(name, Taken())
        taken.wall.append(wall)
        taken.processor.append(processor)


def packages(results: Results) -> None:
    """Note how long the modules of each package take to import, for a process of birds."""
    command = [str(FLOCK), "python", "-X", "importtime", "-c", BIRD]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=LIMIT, check=True)
    found: Counter[str] = Counter()
    for microseconds, package in IMPORT.findall(done.stderr):
        found[package] += int(microseconds)
    for package, microseconds in found.items():
        results.setdefault(package, Taken()).wall.append(1e-6 * microseconds)


def table(title: str, results: Results, yardstick: Taken) -> Table:
    """Return times and their ratios to those of the yardstick."""
    drawn = Table(title=title)
    drawn.add_column("what")
    for column in ("wall, ms", "ratio", "processor, ms", "ratio"):
        drawn.add_column(column, justify="right")
    for name, taken in results.items():
        cells = []
        for mine, unit in ((taken.wall, yardstick.wall), (taken.processor, yardstick.processor)):
            middle = median(mine) if mine else 0.0
            cells += [f"{1e3 * middle:,.0f}", f"{middle / median(unit):.2f}"] if mine else ["", ""]
        drawn.add_row(name, *cells)
    return drawn


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--layouts", type=layout, nargs="+", default=LAYOUTS, metavar="BIRDSxPROCESSES"
    )
    parser.add_argument("--birds", type=int, default=13, help="of the process in phases")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS)
    options = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "101")

    yardstick = Taken()
    results: dict[str, Results] = {title: {} for title in ("tools", "flights", "phases", "imports")}
    with tempfile.TemporaryDirectory() as directory:
        run = Path(directory) / "run"
        take([str(FLOCK), "reference", "--output", str(run)], Taken())
        measurements: dict[str, Callable[[], object]] = {}
        if "tools" in options.only:
            for name, command in tools(run).items():
                taken = results["tools"][name] = Taken()
                measurements[name] = lambda c=command, t=taken: take(c, t)
        if "flights" in options.only:
            for birds, processes in options.layouts:
                name = f"{birds} birds in {processes}"
                first, end = Taken(), Taken()
                results["flights"] |= {f"{name}, first step": first, f"{name}, end": end}
                measurements[name] = lambda b=birds, p=processes, f=first, e=end: fly(b, p, f, e)
        if "phases" in options.only:
            measurements["phases"] = lambda: phases(options.birds, results["phases"])
            measurements["imports"] = lambda: packages(results["imports"])
        with Console(stderr=True).status("") as status:
            for count in range(options.rounds):
                for name, measure in measurements.items():
                    status.update(f"round {count + 1} of {options.rounds}: {name}")
                    take([str(FLOCK), "python", "-c", YARDSTICK], yardstick)
                    measure()

    imports = sorted(results["imports"].items(), key=lambda item: -median(item[1].wall))
    results["imports"] = dict(imports[:MOST_PACKAGES])
    titles = {
        "tools": "tools",
        "flights": "flights of ten steps, from the command on",
        "phases": f"phases of one process of {options.birds} birds",
        "imports": "modules imported by a process of birds, with the cost of measuring",
    }
    console = Console(width=100)
    console.print(
        f"median of {options.rounds} rounds; ratios are to `{YARDSTICK}`: "
        f"{1e3 * median(yardstick.wall):,.0f} ms, of the processor "
        f"{1e3 * median(yardstick.processor):,.0f} ms"
    )
    for part, found in results.items():
        if found:
            console.print(table(titles[part], found, yardstick))


if __name__ == "__main__":
    main()

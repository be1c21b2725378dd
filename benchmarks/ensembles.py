# SPDX-License-Identifier: Apache-2.0
"""The rates of ensembles and kernels: this tree, an older tree and a plain JAX script.

    ./flock python -m pip install --no-deps -r requirements/bench.txt
    ./flock python benchmarks/ensembles.py --against ../older [--cases ensemble limits] [--rounds 5]

The older tree is a clone at another commit, set up by `make setup`. Its rates are measured by its
own ./flock. All are measured in turn, round after round; the table gives medians over the rounds
and ratios of medians, and then all rounds. First the final states of some flights are compared.
The clock of a case starts after imports and compilation (but see the case "compile"), and each case
runs on the stated number of cores. XLA has one thread per call; on two cores, each has half of the
members.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from run import LIMIT
from served import Served, on_cores

from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.theory.span_limits import modified_birds
from flock_tools.experiments.integrated_limits import LANES

HERE = Path(__file__).resolve().parent
BIRDS = 13
MEMBERS = 1024
STAGE_MEMBERS = 287
"""Members of the flight in docs/performance.md: 7 modified birds x 41 span ratios."""

FLY = ("--birds", str(BIRDS), "--processes", "1", "--no-record", "--t-max", "4000")
LIMITS = ("--birds", str(BIRDS), "--method", "integrate", "--t-max", "2e4")

COMPARED = {"birds": BIRDS, "members": 16, "steps": 500}
AGREEMENT = 1e-9
"""Largest difference of final positions (b) and speeds (U_min) of the flights compared first."""


class Contestant:
    """A tree of Flock, or the JAX script."""

    def __init__(self, tree: Path | None) -> None:
        """Start nothing yet. `tree` None: the JAX script."""
        self.tree = tree
        script = HERE / ("flock_rates.py" if tree else "jax_flock.py")
        self.rates = [str((tree or HERE.parent) / "flock"), "python", str(script)]
        self._served: dict[int, Served] = {}

    def call(self, cores: int, function: str, **arguments: Any) -> Any:
        """Return the result of a function of its process that has `cores` cores."""
        if cores not in self._served:
            self._served[cores] = Served(self.rates, cores)
        return self._served[cores].call(function, **arguments)

    def print_of(self, cores: int, *words: str) -> Any:
        """Return the JSON that a command prints on `cores` cores."""
        with on_cores(cores):
            done = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=LIMIT)
        if done.returncode:
            raise SystemExit(f"{' '.join(words)}: exit status {done.returncode}")
        return json.loads(done.stdout)

    def tool(self, cores: int, *words: str) -> Any:
        """Return the JSON of a tool of the tree."""
        return self.print_of(cores, self.rates[0], *words, "--json")

    def end(self) -> None:
        """End its processes."""
        for served in self._served.values():
            served.end()


@dataclass(frozen=True)
class Case:
    """What is measured."""

    title: str
    unit: str
    measure: Callable[[Contestant], float]
    script: bool = True
    """Whether the JAX script has it."""


def ensemble(members: int, coupling: str, cores: int) -> Callable[[Contestant], float]:
    """Return the measurement of an ensemble's member-steps per second."""

    def measure(of: Contestant) -> float:
        rate = of.call(cores, "ensemble", birds=BIRDS, members=members, coupling=coupling)
        return float(rate)

    return measure


def limits(cores: int) -> Callable[[Contestant], float]:
    """Return the measurement of the member-steps per second of `limits --method integrate`.

    The JAX script flies an ensemble of as many members as a round of the bisection has.
    """
    ends = 2 * len(modified_birds(FlockConfiguration(birds=BIRDS)))
    sections = max(2, 1 + cores * LANES // ends)
    by_script = ensemble(ends * (sections - 1), "nearest", cores)

    def measure(of: Contestant) -> float:
        if of.tree is None:
            return by_script(of)
        return float(of.tool(cores, "limits", *LIMITS)["member_steps_per_second"])

    return measure


def stage(of: Contestant) -> float:
    """Return the stages per second of a bird's kernel."""
    return float(of.call(1, "stage", birds=BIRDS, members=STAGE_MEMBERS))


def fly(of: Contestant) -> float:
    """Return the steps per second of a flight whose birds share one process."""
    return float(of.tool(2, "fly", *FLY)["steps_per_second"])


def compiled(of: Contestant) -> float:
    """Return the time in which one process compiles all kernels into an empty cache, in s."""
    return float(of.print_of(1, *of.rates, "compile"))


RATE = "member-steps/s"
CASES = {
    "ensemble": Case(f"{MEMBERS:,} members", RATE, ensemble(MEMBERS, "nearest", 1)),
    "ensemble-all": Case(f"{MEMBERS:,} members, all-to-all", RATE, ensemble(MEMBERS, "all", 1)),
    "single": Case("a single flock", "steps/s", ensemble(1, "nearest", 1)),
    "limits": Case("limits --method integrate", RATE, limits(1)),
    "stage": Case(f"stage kernel, {STAGE_MEMBERS} members", "stages/s", stage, script=False),
    "fly": Case("fly, 1 process", "steps/s", fly, script=False),
    "ensemble-2": Case(f"{MEMBERS:,} members, 2 cores", RATE, ensemble(MEMBERS, "nearest", 2)),
    "limits-2": Case("limits --method integrate, 2 cores", RATE, limits(2)),
    "compile": Case("compiling all kernels", "s", compiled, script=False),
}
TWO_CORES = {"ensemble-2": "ensemble", "limits-2": "limits"}
"""Cases on two cores, and the same on one."""


def difference(contestants: dict[str, Contestant], coupling: str) -> float:
    """Return by how much final positions and speeds differ at most from those of this tree.

    Raises SystemExit if that is more than AGREEMENT.
    """
    found = [
        np.array(of.call(1, "states", coupling=coupling, **COMPARED)) for of in contestants.values()
    ]
    most = {name: float(np.abs(state - found[0]).max()) for name, state in zip(contestants, found)}
    for name, apart in most.items():
        if not apart <= AGREEMENT:
            raise SystemExit(f"{name}, {coupling}: final states differ by {apart:g}")
    return max(most.values())


def measured(
    contestants: dict[str, Contestant], cases: list[str], rounds: int
) -> dict[str, dict[str, list[float]]]:
    """Return what was measured, by case and contestant, round by round."""
    values: dict[str, dict[str, list[float]]] = {
        case: {name: [] for name, of in contestants.items() if of.tree or CASES[case].script}
        for case in cases
    }
    with Console(stderr=True).status("") as status:
        for count in range(rounds):
            for case, rates in values.items():
                for name, found in rates.items():
                    status.update(f"round {count + 1} of {rounds}: {case}, {name}")
                    found.append(CASES[case].measure(contestants[name]))
    return values


def facts(values: dict[str, dict[str, list[float]]]) -> dict[str, Any]:
    """Return titles, rounds, medians and ratios of medians, by case."""
    told: dict[str, Any] = {}
    for case, rounds in values.items():
        middle = {name: median(found) for name, found in rounds.items()}
        told[case] = {
            "title": CASES[case].title,
            "unit": CASES[case].unit,
            "rounds": rounds,
            "median": middle,
            "this_to": {name: middle["this"] / rate for name, rate in middle.items()},
        }
    for case, one in TWO_CORES.items():
        if case in told and one in told:
            rates = told[one]["median"]
            told[case]["to_one_core"] = {
                name: rate / rates[name] for name, rate in told[case]["median"].items()
            }
    return told


def show(told: dict[str, Any], names: list[str], console: Console) -> None:
    """Print the medians and ratios, and all rounds."""
    others = [name for name in names if name != "this"]
    table = Table(title=f"{BIRDS} birds, medians")
    table.add_column("what")
    table.add_column("unit")
    for column in (*names, *(f"this/{name}" for name in others)):
        table.add_column(column, justify="right")
    for case in told.values():
        middle, ratios = case["median"], case["this_to"]
        digits = 1 if case["unit"] == "s" else 0
        rates = [f"{middle[name]:,.{digits}f}" if name in middle else "" for name in names]
        quotients = [f"{ratios[name]:.2f}" if name in ratios else "" for name in others]
        table.add_row(case["title"], case["unit"], *rates, *quotients)
    console.print(table)
    for case in told.values():
        if quotients := case.get("to_one_core"):
            text = ", ".join(f"{name} {quotient:.2f}" for name, quotient in quotients.items())
            console.print(f"{case['title']}, to one core: {text}")
    console.print("all rounds:")
    for name, case in told.items():
        for of, found in case["rounds"].items():
            digits = 1 if case["unit"] == "s" else 0
            console.print(f"  {name}, {of}: {' '.join(f'{rate:,.{digits}f}' for rate in found)}")


def arguments() -> argparse.Namespace:
    """Return the options. Exit with status 2 if they cannot be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", metavar="DIR", type=Path, help="an older tree, set up")
    parser.add_argument(
        "--cases",
        nargs="+",
        choices=CASES,
        default=list(CASES),
        metavar="CASE",
        help=f"what is measured (all): {', '.join(CASES)}",
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--no-jax", action="store_true", help="leave out the JAX script")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error("--rounds: must be 1 or more")
    if options.against and not (options.against / "flock").is_file():
        parser.error(f"--against {options.against}: there is no ./flock")
    if len(os.sched_getaffinity(0)) < 2 and {*TWO_CORES, "fly"} & {*options.cases}:
        parser.error(f"{', '.join(TWO_CORES)} and fly need two cores: choose other --cases")
    return options


def main() -> None:
    """Compare states, measure, and print."""
    options = arguments()
    contestants = {"this": Contestant(HERE.parent)}
    if options.against:
        contestants["old"] = Contestant(options.against.resolve())
    if not options.no_jax:
        contestants["jax"] = Contestant(None)
    try:
        apart = {coupling: difference(contestants, coupling) for coupling in COUPLINGS}
        told = facts(measured(contestants, options.cases, options.rounds))
    finally:
        for of in contestants.values():
            of.end()
    if options.json:
        json.dump({"differences": apart, "cases": told}, sys.stdout, indent=2)
        print()
        return
    console = Console(width=120)
    show(told, list(contestants), console)
    text = ", ".join(f"{most:.1g} ({coupling})" for coupling, most in apart.items())
    console.print(f"largest difference of final states: {text}")


if __name__ == "__main__":
    main()

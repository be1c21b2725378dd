# SPDX-License-Identifier: Apache-2.0
"""Functions of another process, called through a pipe: its start is not measured.

The process calls `serve`, its user `Served`. A call is one line of JSON, the name of a function and
its arguments; the answer is one line with the result.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from threading import Barrier
from typing import Any, Protocol

import numpy as np

SECONDS = 1.0
"""Least duration of a measurement of `rate`."""

AT_ONCE = 20_000
"""Member-steps between two looks at the clock: some hundredths of a second."""


class Advances(Protocol):
    def advance(self, steps: int, /) -> object: ...


def serve(*functions: Callable[..., Any]) -> None:
    """Answer calls of these functions until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is not an answer
    names = {function.__name__: function for function in functions}
    for line in sys.stdin:
        name, arguments = json.loads(line)
        print(json.dumps(names[name](**arguments)), file=answers, flush=True)


class Served:
    """A process that serves functions."""

    def __init__(self, command: list[str], cores: int) -> None:
        """Start it on `cores` cores."""
        self.command = command
        with on_cores(cores):
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )

    def call(self, function: str, **arguments: Any) -> Any:
        """Return the result of a function. Raises SystemExit if the process has ended."""
        assert self._process.stdin
        assert self._process.stdout
        with suppress(BrokenPipeError):  # then there is no answer
            print(json.dumps([function, arguments]), file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit(f"{' '.join(self.command)}: {function} has failed")
        return json.loads(answer)

    def end(self) -> None:
        """Let the process end."""
        with suppress(BrokenPipeError):
            self._process.communicate()


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """Let processes that start in the block run on the first `count` cores of this process."""
    present = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(present)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, present)


def span_ratios(birds: int, members: int) -> np.ndarray:
    """Return the span ratios, (birds, members), of flocks that can fly in formation."""
    return np.random.default_rng(18).uniform(0.999, 1.001, (birds, members))


def rate(fly: Callable[[np.ndarray], Advances], ratio: np.ndarray) -> float:
    """Return member-steps per second of the ensemble with the span ratios `ratio`.

    Its members are divided among one thread for each core of this process. `fly` starts an
    ensemble. Each takes some steps before the measurement.
    """
    threads = len(os.sched_getaffinity(0))
    ready = Barrier(threads)

    def run(block: np.ndarray) -> tuple[int, float, float]:
        members = block.shape[1]
        steps = max(1, AT_ONCE // members)
        ensemble = fly(block)
        ensemble.advance(steps)
        ready.wait()
        taken, begun = 0, time.perf_counter()
        while (now := time.perf_counter()) < begun + SECONDS:
            ensemble.advance(steps)
            taken += steps * members
        return taken, begun, now

    with ThreadPoolExecutor(threads) as pool:
        runs = list(pool.map(run, np.array_split(ratio, threads, axis=1)))
    taken, begun, ended = zip(*runs, strict=True)
    return float(sum(taken) / (max(ended) - min(begun)))

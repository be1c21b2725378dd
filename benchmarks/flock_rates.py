# SPDX-License-Identifier: Apache-2.0
"""The rates of the kernels of one tree of Flock, for ensembles.py.

`TREE/flock python benchmarks/flock_rates.py` serves these functions (served.py) for the Flock of
TREE, which may be of another version than this file. `... flock_rates.py compile` compiles all
kernels into an empty cache and prints the time that this takes.
"""

from __future__ import annotations

import inspect
import os
import runpy
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from served import SECONDS, rate, serve, span_ratios

if TYPE_CHECKING:
    from flock_sim.reference.integrator import Reference

BIRD = 7
NEIGHBOURS = (6, 8)

KERNEL = ("tick", "dt", "own", "geometry", "heard", "mine", "work")
"""Arguments of the stage kernel that `stage_kernel` can give."""


def states(birds: int, members: int, coupling: str, steps: int) -> list[list[list[float]]]:
    """Return position and speed after `steps` steps, each (birds, members)."""
    flown = _reference(coupling, span_ratios(birds, members))
    flown.advance(steps)
    return [flown.position.tolist(), flown.speed.tolist()]


def ensemble(birds: int, members: int, coupling: str) -> float:
    """Return member-steps per second."""
    return rate(partial(_reference, coupling), span_ratios(birds, members))


def stage(birds: int, members: int) -> float:
    """Return the stages per second of the kernel of a bird with two neighbours."""
    call, ticks = _stage_kernel(birds, members), 1000
    done, begun = 0, time.perf_counter()
    while (now := time.perf_counter()) < begun + SECONDS:
        for tick in range(ticks):
            call(tick)
        done += ticks
    return done / (now - begun)


def _reference(coupling: str, ratio: np.ndarray) -> Reference:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.reference.integrator import Reference

    steps = 10**6  # none is recorded but the first: the flight ends before
    flown = FlockConfiguration(
        birds=len(ratio), coupling=coupling, t_max=float(steps), record_every=steps
    )
    return Reference(flown, ratio)


def _stage_kernel(birds: int, members: int) -> Callable[[int], object]:
    """Return a function that calls the stage kernel for a tick, after one call.

    The bird is 1.4 b nearer to its neighbours than at the start, about as in the steady state. It
    stays there, since steps are short. The kernel is called directly, or by its only caller if it
    has other arguments in this tree.
    """
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.configuration.perturbation import Perturbation
    from flock_sim.messages.types import Wing
    from flock_sim.protocol.bird_kernel import feel_and_move
    from flock_sim.protocol.motion import Motion
    from flock_sim.protocol.neighbours import Neighbourhood

    ratio = span_ratios(birds, members)
    texts = tuple(
        f"{bird}={','.join(map(repr, row))}" for bird, row in enumerate(ratio.tolist(), 1)
    )
    flown = FlockConfiguration(birds=birds, dt=1e-6, t_max=1.0, span_ratios=texts)

    def motion(bird: int) -> Motion:
        around = Neighbourhood(bird, flown)
        for other in around.birds:
            around.hear(Wing(1, other, ratio[other - 1]), 1)
        started = Motion(bird, flown, around)
        started.start()
        if bird in NEIGHBOURS:
            started.push(
                Perturbation(0, bird, member, 1.4, 0.0) for member in range(1, members + 1)
            )
        return started

    moving = motion(BIRD)
    heard = np.array([[motion(bird)._mine[0] for bird in NEIGHBOURS]] * 2)

    def directly(tick: int) -> None:
        feel_and_move(tick, 1e-6, moving._own, moving._geometry, heard, moving._mine, moving._work)

    def by_caller(tick: int) -> None:
        moving.compute(tick, heard)

    known = tuple(inspect.signature(feel_and_move).parameters) == KERNEL
    call = directly if known else by_caller
    call(0)
    return call


def compile_all() -> None:
    """Print how long one process takes to compile all kernels into an empty cache, in s."""
    with tempfile.TemporaryDirectory() as empty:
        os.environ["NUMBA_CACHE_DIR"] = empty
        begun = time.perf_counter()
        from flock_sim.physics import kernel_cache

        kernel_cache.KERNELS = Path(empty)  # instead of the one beside the sources
        from flock_sim.launcher import precompile

        if hasattr(precompile, "GROUPS"):
            for compile_group in precompile.GROUPS:
                compile_group()
        else:  # an older tree
            runpy.run_module("flock_sim.launcher.precompile", run_name="__main__")
        seconds = time.perf_counter() - begun
        if not list(Path(empty).rglob("*.kernel")):
            raise SystemExit("no kernel was compiled into the empty cache")
    print(seconds)


if __name__ == "__main__":
    if sys.argv[1:] == ["compile"]:
        compile_all()
    else:
        serve(states, ensemble, stage)

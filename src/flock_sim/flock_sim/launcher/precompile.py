# SPDX-License-Identifier: Apache-2.0
"""Compile all kernels into the cache on disk, so that no tool waits for the compiler.

`make setup` runs `python -m flock_sim.launcher.precompile`. Tools call these functions before they
measure their own rates. Each function imports only the kernels that the tool is about to use.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from flock_sim.configuration.choices import COUPLINGS
from flock_sim.configuration.flock_configuration import FlockConfiguration

FORCING = ("constant:force=0", "sine:amplitude=0,period=1", "keeper:gap=1,stiffness=0")
"""Forcing without random numbers, with each built-in law."""
GUSTS = ("gust:std=0", "gust:std=0,time=1")
"""Forcing with random numbers, with each built-in law."""


def warm_reference(links: Sequence[str] = (), forcing: Sequence[str] = ()) -> None:
    """Call every kernel of the reference once, with the argument types of the reference.

    `links` and `forcing` are those of the next flight; without any, its links are plain.
    """
    from flock_sim.reference.integrator import Reference

    configuration = FlockConfiguration(
        birds=2, t_max=2.0, links=tuple(links), forcing=tuple(forcing)
    )
    for _ in Reference(configuration).fly():
        pass


def warm_bird() -> None:
    """Do the same with the kernels of a bird whose links are plain."""
    from flock_sim.messages.types import Checkpoint, Grant, Stage, Wing
    from flock_sim.protocol.bird import BirdProtocol

    alone = FlockConfiguration(birds=1, t_max=1.0)
    bird = BirdProtocol(1, alone)
    bird.receive_grant(Grant(run_id=1, step=0, end=1, dt=1.0, epoch=1))
    bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    bird.receive_grant(Grant(run_id=1, step=1, end=1, dt=1.0, epoch=1))
    configuration = FlockConfiguration(birds=2, t_max=2.0)
    bird = BirdProtocol(1, configuration, run_id=1)
    bird.receive_grant(Grant(run_id=1, step=0, end=2, dt=1.0, epoch=1))
    bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    bird.receive_wing(Wing(1, 2, configuration.span_ratio[1]))
    one = np.ones(1)
    bird.receive_stage(Stage(1, 0, 1, 2, 0, one, one, one).encode())


def warm_links() -> None:
    """Do the same with the kernels of links that are not plain, and of a free flight."""
    from flock_sim.messages.types import Checkpoint, Grant, Wing
    from flock_sim.protocol.bird import BirdProtocol
    from flock_sim.protocol.latest_values import LatestValues
    from flock_sim.protocol.session import Channel

    configuration = FlockConfiguration(birds=2, t_max=2.0, links=("hold",))
    end, dt = configuration.steps, configuration.dt
    birds = [BirdProtocol(bird, configuration, run_id=1) for bird in (1, 2)]
    said = []
    for bird in birds:
        bird.receive_grant(Grant(run_id=1, step=0, end=end, dt=dt, epoch=1))
        for other, ratio in enumerate(configuration.span_ratio, 1):
            bird.receive_wing(Wing(1, other, ratio))
        said += bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    for channel, data in said:
        if channel is Channel.STAGE:
            birds[0].receive_stage(data)
    LatestValues(1, (2,), configuration).known(0, 0)


def warm_exchange() -> None:
    """Do the same with the compiled exchange of stages, without any message."""
    from flock_sim.protocol.bird import BirdProtocol
    from flock_sim.ros.compiled_exchange import available, exchange

    if available():
        exchange(BirdProtocol(1, FlockConfiguration(birds=2)).words, 1.0, False)


def warm_equilibrium(coupling: str) -> None:
    """Do the same with the steady states of flocks of one coupling."""
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.equilibrium import equilibrium

    equilibrium(Flock.of(FlockConfiguration(birds=3, coupling=coupling)))


def warm_arrangement() -> None:
    """Do the same with the search for the best order of birds."""
    from flock_sim.physics.scaling import Scales
    from flock_sim.theory.arrangement.branch_and_bound import ChainSearch, Wanted
    from flock_sim.theory.arrangement.orders import Kinds

    scales = Scales.of(FlockConfiguration())
    kinds = Kinds.of(scales, "nearest", np.array([0.99, 1.0, 1.01]))
    kinds.all_orders()
    ChainSearch(kinds).find(Wanted(0.0), lambda done: None)


def warm_stability() -> None:
    """Do the same with the eigenvalues of steady states."""
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.linear_stability import eigenvalues

    flock = Flock.of(FlockConfiguration(birds=3))
    eigenvalues(flock, np.ones((2, 1)), np.ones(1))


def warm_sensitivity() -> None:
    """Do the same with the derivatives of steady states."""
    from flock_sim.physics.flock import Flock
    from flock_sim.theory.equilibrium import equilibrium
    from flock_sim.theory.sensitivity import sensitivity

    flock = Flock.of(FlockConfiguration(birds=3))
    sensitivity(flock, equilibrium(flock))


def warm_response(coupling: str) -> None:
    """Do the same with the linear responses of flocks of one coupling."""
    from flock_sim.physics.flock import Flock
    from flock_sim.response.linear_response import frequency_response, linear_response
    from flock_sim.theory.equilibrium import equilibrium

    flock = Flock.of(FlockConfiguration(birds=3, coupling=coupling))
    linear_response(flock, gust=1e-5)
    frequency_response(flock, equilibrium(flock), 0.01)
    linear_response(flock, lag=1.0, model="hold")


def warm_integral() -> None:
    """Do the same with the interaction integral."""
    from flock_sim.physics.aerodynamics import interaction_integral

    interaction_integral(1.0, 2.0, 0.5, 0.5)


def warm_flights() -> None:
    """Do the same with all kernels of flights, with and without ROS."""
    warm_reference(forcing=FORCING + GUSTS)
    warm_bird()
    warm_links()
    warm_exchange()


def warm_steady_states() -> None:
    """Do the same with all kernels of steady states, and the interaction integral."""
    for coupling in COUPLINGS:
        warm_equilibrium(coupling)
    warm_sensitivity()
    warm_arrangement()
    warm_integral()


def warm_disturbances() -> None:
    """Do the same with all kernels of linear stability and responses."""
    for coupling in COUPLINGS:
        warm_response(coupling)
    warm_stability()


GROUPS = (warm_flights, warm_steady_states, warm_disturbances)
"""Functions that together compile all kernels. The one that takes longest is the first."""


def main() -> None:
    """Compile all kernels, on all cores."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # The exchange loads ROS, which would end this process if that middleware is not installed.
    os.environ.pop("RMW_IMPLEMENTATION", None)
    # What two groups share may be compiled twice; one result is kept.
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn")) as pool:
        for compiled in [pool.submit(group) for group in GROUPS]:
            compiled.result()


if __name__ == "__main__":
    main()

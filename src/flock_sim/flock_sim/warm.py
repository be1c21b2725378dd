# SPDX-License-Identifier: Apache-2.0
"""Compile all kernels into the cache on disk, so that nobody waits for a compiler.

`make setup` runs `python -m flock_sim.warm`.
"""

from __future__ import annotations

from flock_sim.core.aerodynamics import interaction_integral
from flock_sim.core.configuration import COUPLINGS, FlockConfiguration
from flock_sim.core.equilibrium import equilibrium
from flock_sim.core.flock import Flock
from flock_sim.core.links.latest import Latest
from flock_sim.core.messages import Checkpoint, Grant, Wing
from flock_sim.core.monolith import Monolith
from flock_sim.core.protocol import BirdProtocol, Channel
from flock_sim.core.stability import eigenvalues
from flock_sim.nodes.exchange import available, exchange


def warm() -> None:
    """Call every kernel of a flight once, with the types that flights call it with."""
    configuration = FlockConfiguration(birds=2, t_max=2.0)
    for _ in Monolith(configuration).fly():
        pass
    alone = FlockConfiguration(birds=1, t_max=1.0)
    bird = BirdProtocol(1, alone)
    bird.receive_grant(Grant(run_id=1, step=0, end=1, dt=1.0, epoch=1))
    bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    bird.receive_grant(Grant(run_id=1, step=1, end=1, dt=1.0, epoch=1))
    bird = BirdProtocol(1, configuration, run_id=1)
    bird.receive_grant(Grant(run_id=1, step=0, end=2, dt=1.0, epoch=1))
    bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    bird.receive_wing(Wing(1, 2, configuration.span_ratio[1]))
    interaction_integral(1.0, 2.0, 0.5, 0.5)


def warm_links() -> None:
    """Do the same with links that are not plain, and with those of a free flight."""
    configuration = FlockConfiguration(birds=2, t_max=2.0, links=("hold",))
    for _ in Monolith(configuration).fly():
        pass
    birds = [BirdProtocol(bird, configuration, run_id=1) for bird in (1, 2)]
    said = []
    for bird in birds:
        bird.receive_grant(Grant(run_id=1, step=0, end=2, dt=1.0, epoch=1))
        for other in (1, 2):
            bird.receive_wing(Wing(1, other, configuration.span_ratio[other - 1]))
        said += bird.receive_checkpoint(Checkpoint.of_start(run_id=1, epoch=1))
    for channel, data in said:
        if channel is Channel.STAGE:
            birds[0].receive_stage(data)
    Latest(1, (2,), configuration).known(0, 0)


def warm_exchange() -> None:
    """Do the same with the exchange of stages, without any message."""
    leg = BirdProtocol(1, FlockConfiguration(birds=2)).leg()
    if leg is not None and available():
        leg.begin(tick=0, end=1, run_id=1, epoch=1, lacking=(set(), set()))
        exchange(leg.words, 1.0, False)


def warm_steady_states() -> None:
    """Do the same with what is known of flocks without flying them."""
    for coupling in COUPLINGS:
        flock = Flock.of(FlockConfiguration(birds=3, coupling=coupling))
        state = equilibrium(flock)
        eigenvalues(flock, state.spacing, state.speed)


if __name__ == "__main__":
    warm()
    warm_links()
    warm_exchange()
    warm_steady_states()

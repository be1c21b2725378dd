# SPDX-License-Identifier: Apache-2.0
"""The stability diagram by the paper's protocol: flocks integrated to t_max, without ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.progress import counter
from flock_sim.launcher.precompile import warm_reference
from flock_sim.theory.limit_search import Limits
from flock_sim.theory.span_limits import search
from flock_tools.experiments.ensemble import Ensembles
from flock_tools.experiments.workers import workers

LANES = 8
"""Members per worker and round: a single member costs twice as much."""


def integrated_limits(
    configuration: FlockConfiguration,
    birds: Sequence[int],
    low: float,
    high: float,
    points: int,
    resolution: float,
    scheduler: str | None,
) -> tuple[list[Limits], dict[str, Any]]:
    """Return the limits of each of `birds` to `resolution`, and facts of the search.

    The first `points` span ratios of each bird are evenly spaced from `low` to `high`. `scheduler`
    is the address of a Dask scheduler; None: the cores of this machine. Raises FlockError as
    `workers` does.
    """
    warm_reference()  # the rate does not include loading compiled code
    with workers(scheduler) as pool:
        # Bisection if that keeps all workers busy, otherwise more sections per round.
        sections = max(2, 1 + pool.count * LANES // (2 * len(birds)))
        width = (high - low) / (points - 1)
        rounds = math.ceil(math.log(width / resolution) / math.log(sections))
        trials = 1 + len(birds) * (points + 1 + 2 * max(0, rounds) * (sections - 1))
        with counter("integrating", "member-steps", trials * configuration.steps) as show:
            fleet = Ensembles(configuration, pool, show)
            begun = time.perf_counter()
            found = search(
                configuration,
                birds,
                low,
                high,
                resolution,
                fleet.opened_gaps,
                points - 1,
                sections,
            )
            as_given = not fleet.opened_gaps(configuration.span_ratio)[0]
            seconds = time.perf_counter() - begun
    return found, {
        "as_given": as_given,
        "resolution": resolution,
        "dt": configuration.dt,
        "t_max": configuration.t_max,
        "workers": pool.count,
        "seconds": seconds,
        "member_steps": fleet.member_steps,
        "member_steps_per_second": fleet.member_steps / seconds,
    }

# SPDX-License-Identifier: Apache-2.0
"""What a free flight can't do: be late, lose or record by order, be very slow, or go back."""

from __future__ import annotations

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.links.latest import check_links
from flock_sim.errors import FlockError

NO_WAY_BACK = (
    "somebody has died and come back, and a free flight can't go back to what was: fly it anew"
)

GONE = "it was flown freely, and what its birds knew is gone"


def check_free(
    configuration: FlockConfiguration, factor: float, timeout: float, record_stages: bool
) -> None:
    """Raise FlockError where a flight can't be free: at `factor` times real time, stages recorded.

    `timeout` is the longest standstill, in s, which a step must be well below.
    """
    check_links(configuration)
    if record_stages:
        raise FlockError(
            "a free flight has no Runge-Kutta stages to record, since birds say one state a step: "
            "leave --record-stages out"
        )
    step = configuration.dt * configuration.second / factor
    if step > 0.5 * timeout:
        raise FlockError(
            f"real-time factor {factor:g}: a step would take {step:.4g} s; it must take at most "
            f"half of the timeout of {timeout:g} s: raise one of them"
        )

# SPDX-License-Identifier: Apache-2.0
"""The refusal of bad links by tools that solve for the exact coupling."""

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.errors import FlockError


def check_links_exact(configuration: FlockConfiguration, tool: str) -> None:
    """Raise FlockError unless every bird knows at all times what its neighbours say."""
    if not configuration.linkage.plain:
        raise FlockError(
            f"links {' '.join(configuration.links)}: {tool} solves the exact coupling, for links "
            "that are `exact`, without faults; leave them out, or fly over them with `./flock fly`"
        )

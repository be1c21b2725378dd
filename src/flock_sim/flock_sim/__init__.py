# SPDX-License-Identifier: Apache-2.0
"""A laboratory for decentralised formation flight: the physics core and the ROS 2 nodes.

The names in `__all__` are public. Each is imported when it is first used, so `import flock_sim`
loads neither ROS nor NumPy.
"""

from typing import TYPE_CHECKING

from flock_sim.public_names import importer

if TYPE_CHECKING:
    from flock_sim.analysis.metrics import Metrics as Metrics
    from flock_sim.configuration.flock_configuration import FlockConfiguration as FlockConfiguration
    from flock_sim.configuration.perturbation import Perturbation as Perturbation
    from flock_sim.errors import FlockError as FlockError
    from flock_sim.errors import RunFailed as RunFailed
    from flock_sim.links.models import LinkModel as LinkModel
    from flock_sim.links.registry import register as register
    from flock_sim.nodes.bird import BirdNode as BirdNode
    from flock_sim.physics.flock import Flock as Flock
    from flock_sim.physics.flock_state import FlockState as FlockState
    from flock_sim.recording.run import Run as Run
    from flock_sim.reference.integrator import Reference as Reference
    from flock_sim.response.linear_response import Gust as Gust
    from flock_sim.response.linear_response import Response as Response
    from flock_sim.response.linear_response import frequency_response as frequency_response
    from flock_sim.response.linear_response import linear_response as linear_response
    from flock_sim.theory.arrangement.arrange import Arrangement as Arrangement
    from flock_sim.theory.arrangement.arrange import arrange as arrange
    from flock_sim.theory.delayed.nearest import DelayedNearest as DelayedNearest
    from flock_sim.theory.delayed.nearest import delayed_nearest as delayed_nearest
    from flock_sim.theory.delayed.stability import Crossing as Crossing
    from flock_sim.theory.delayed.stability import crossings as crossings
    from flock_sim.theory.equilibrium import Equilibrium as Equilibrium
    from flock_sim.theory.equilibrium import equilibrium as equilibrium
    from flock_sim.theory.limit_search import Limits as Limits
    from flock_sim.theory.sensitivity import Sensitivity as Sensitivity
    from flock_sim.theory.sensitivity import sensitivity as sensitivity
    from flock_sim.theory.span_limits import exact_limits as exact_limits
    from flock_sim.theory.thrust_limits import exact_thrust_limits as exact_thrust_limits

__version__ = "0.1.0"

_MODULES = {
    "Arrangement": "flock_sim.theory.arrangement.arrange",
    "BirdNode": "flock_sim.nodes.bird",
    "Crossing": "flock_sim.theory.delayed.stability",
    "DelayedNearest": "flock_sim.theory.delayed.nearest",
    "Equilibrium": "flock_sim.theory.equilibrium",
    "Flock": "flock_sim.physics.flock",
    "FlockConfiguration": "flock_sim.configuration.flock_configuration",
    "FlockError": "flock_sim.errors",
    "FlockState": "flock_sim.physics.flock_state",
    "Limits": "flock_sim.theory.limit_search",
    "Gust": "flock_sim.response.linear_response",
    "LinkModel": "flock_sim.links.models",
    "Metrics": "flock_sim.analysis.metrics",
    "Perturbation": "flock_sim.configuration.perturbation",
    "Reference": "flock_sim.reference.integrator",
    "Response": "flock_sim.response.linear_response",
    "Run": "flock_sim.recording.run",
    "RunFailed": "flock_sim.errors",
    "Sensitivity": "flock_sim.theory.sensitivity",
    "arrange": "flock_sim.theory.arrangement.arrange",
    "crossings": "flock_sim.theory.delayed.stability",
    "delayed_nearest": "flock_sim.theory.delayed.nearest",
    "equilibrium": "flock_sim.theory.equilibrium",
    "exact_limits": "flock_sim.theory.span_limits",
    "exact_thrust_limits": "flock_sim.theory.thrust_limits",
    "frequency_response": "flock_sim.response.linear_response",
    "linear_response": "flock_sim.response.linear_response",
    "register": "flock_sim.links.registry",
    "sensitivity": "flock_sim.theory.sensitivity",
}
"""The module that defines each public name."""

__all__ = list(_MODULES)

if not TYPE_CHECKING:  # so that mypy knows every name
    __getattr__ = importer(__name__, _MODULES)


def __dir__() -> list[str]:
    return [*globals(), *__all__]

# SPDX-License-Identifier: Apache-2.0
"""Formation flight in Python: steady states, stability, disturbances, runs and sweeps of flocks.

    import flockflight as ff

    flock = ff.Flock(spans={3: 0.98, 11: 0.98})
    flock.equilibrium()                                       # exact, without flying
    flock.run()                                               # a flight in one loop
    flock.fly()                                               # the same flight over ROS 2
    flock.sweep({"span_ratio[4]": [0.98, 1.0, 1.02]}).run()   # a flight for each value

Results are `xarray.Dataset`s. `table` turns one into a table. Only `Flock.fly` needs ROS 2. Each
name is imported when it is first used.

Units are those of the paper: lengths in b (half the wing span of the standard bird), speeds in
U_min (its speed of least drag), times in b/U_min, forces in rho b^2 U_min^2.
"""

from typing import TYPE_CHECKING

from flock_sim.public_names import importer

if TYPE_CHECKING:
    from flock_sim.errors import FlockError as FlockError
    from flock_sim.errors import RunFailed as RunFailed
    from flock_sim.links.models import LinkModel as LinkModel
    from flock_sim.links.registry import register as register
    from flock_tools.runs.comparison import Comparison as Comparison
    from flockflight.flock import Flock as Flock
    from flockflight.flock import Sweep as Sweep
    from flockflight.recorded import compare as compare
    from flockflight.recorded import load as load
    from flockflight.recorded import picture as picture
    from flockflight.results import table as table
    from flockflight.values import Force as Force
    from flockflight.values import Link as Link
    from flockflight.values import Push as Push

_MODULES = {
    "Comparison": "flock_tools.runs.comparison",
    "Flock": "flockflight.flock",
    "FlockError": "flock_sim.errors",
    "Force": "flockflight.values",
    "Link": "flockflight.values",
    "LinkModel": "flock_sim.links.models",
    "Push": "flockflight.values",
    "RunFailed": "flock_sim.errors",
    "Sweep": "flockflight.flock",
    "compare": "flockflight.recorded",
    "load": "flockflight.recorded",
    "picture": "flockflight.recorded",
    "register": "flock_sim.links.registry",
    "table": "flockflight.results",
}
"""The module that defines each public name."""

__all__ = list(_MODULES)

if not TYPE_CHECKING:  # mypy reads the imports above
    __getattr__ = importer(__name__, _MODULES)


def __dir__() -> list[str]:
    return [*globals(), *__all__]

# SPDX-License-Identifier: Apache-2.0
"""Recorded flights as data, comparisons, experiments and figures.

The names in `__all__` are public. Each is imported when it is first used.
"""

from typing import TYPE_CHECKING

from flock_sim.public_names import importer

if TYPE_CHECKING:
    from flock_tools.runs.comparison import Comparison as Comparison
    from flock_tools.runs.comparison import compare as compare
    from flock_tools.runs.dataset import load as load
    from flock_tools.testing import fly as fly

_MODULES = {
    "Comparison": "flock_tools.runs.comparison",
    "compare": "flock_tools.runs.comparison",
    "fly": "flock_tools.testing",
    "load": "flock_tools.runs.dataset",
}
"""The module that defines each public name."""

__all__ = list(_MODULES)

if not TYPE_CHECKING:  # mypy reads the imports above
    __getattr__ = importer(__name__, _MODULES)


def __dir__() -> list[str]:
    return [*globals(), *__all__]

# SPDX-License-Identifier: Apache-2.0
"""How numbers are held and how their loops are compiled."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import numba
import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a loop over numbers; compiled code is kept on disk beside the module.

    Arithmetic is that of IEEE 754 to the letter: no `fastmath`, so that every caller gets the same
    bits, and 1/0 = inf, so that a member that diverges stops nobody.
    """
    compiled: Function = numba.njit(cache=True, error_model="numpy", fastmath=False)(function)
    return compiled

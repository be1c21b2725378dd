# SPDX-License-Identifier: Apache-2.0
"""The import of numba without two packages that numba imports and our kernels do not use.

In every process, the import of both takes about as long as that of numba itself.

- scipy.linalg: when numba loads its first kernel, it imports scipy to check for a BLAS. Our kernels
  need no BLAS. A function that needs it, such as one with a product of matrices, still gets it:
  numba checks again when it compiles this function, and imports scipy then.
- coverage, if it is installed: for the coverage of compiled code. A program that measures
  coverage imports this package before it imports Flock, and numba uses it then.

If numba is already imported, or has another structure than expected, it is not changed.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec


@contextmanager
def _no_collection() -> Iterator[None]:
    """Exclude all objects made in the block from garbage collection, now and later."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if enabled:
            gc.enable()


@contextmanager
def _not_there(package: str) -> Iterator[None]:
    """Make imports of `package` fail in the block, unless it is already imported."""
    if package in sys.modules:
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]  # as the import system has it
    try:
        yield
    finally:
        sys.modules.pop(package, None)


def _load_registries() -> None:
    """Load what numba loads with its first kernel, without its check for scipy's BLAS."""
    if "numba.np.arraymath" in sys.modules or find_spec("scipy") is None:
        return
    try:
        from numba.core.registry import cpu_target
        from numba.np import linalg

        contexts = cpu_target.typing_context, cpu_target.target_context
        ensure_blas = linalg.ensure_blas
    except (ImportError, AttributeError):
        return
    linalg.ensure_blas = lambda: None
    try:
        from numba.np import arraymath

        arraymath.ensure_blas = ensure_blas
        for context in contexts:
            context.refresh()
    except (ImportError, AttributeError):
        pass  # numba reports the error when it loads a kernel
    finally:
        linalg.ensure_blas = ensure_blas


with _no_collection():
    with _not_there("coverage"):
        import numba
    _load_registries()

__all__ = ["numba"]

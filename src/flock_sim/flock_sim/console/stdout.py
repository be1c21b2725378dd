# SPDX-License-Identifier: Apache-2.0
"""Standard output is for results: other output of the middleware goes to standard error."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

STDOUT, STDERR = 1, 2


@contextmanager
def results_only_on_stdout() -> Iterator[None]:
    """Redirect standard output of this process and its children to standard error in the block.

    Fast DDS prints its errors on standard output, in the middle of our JSON.
    """
    sys.stdout.flush()
    kept = os.dup(STDOUT)
    os.dup2(STDERR, STDOUT)
    try:
        yield
    finally:
        os.dup2(kept, STDOUT)
        os.close(kept)

# SPDX-License-Identifier: Apache-2.0
"""The standard streams. Standard output is for results: other output goes to standard error."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

STDOUT, STDERR = 1, 2

_MODES = {"stdin": os.O_RDONLY, "stdout": os.O_RDONLY, "stderr": os.O_WRONLY}
"""How a missing stream is opened: writing to the missing stdout must fail, as results are lost."""


def open_missing_streams() -> None:
    """Open the standard streams that this process was started without, and prepare stdout.

    Otherwise, a file that the process opens would become a standard stream. Characters that the
    encoding of stdout lacks, and undecodable bytes of file names, are escaped in it.
    """
    for number, (name, mode) in enumerate(_MODES.items()):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, mode)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            way = "r" if name == "stdin" else "w"
            setattr(sys, name, open(number, way, closefd=False))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


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

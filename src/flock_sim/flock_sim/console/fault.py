# SPDX-License-Identifier: Apache-2.0
"""The line on an exception that no code has foreseen: a fault of Flock, or of a disk."""

from __future__ import annotations

import errno
from pathlib import Path

from flock_sim.errors import RunFailed, remedy
from flock_sim.outside.printing import shown

PACKAGES = {"flock_sim", "flock_tools", "flockflight"}

TRACEBACK = "FLOCK_TRACEBACK"
"""Environment variable that lets such an exception through, for its traceback."""

_OF_THE_DISK = (
    *(errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ESTALE),
    *(errno.EMFILE, errno.ENFILE),
)
"""Errors of a disk, or of a limit of the system, which any call on a file can return."""


def disk_failure(error: OSError) -> RunFailed | None:
    """Return the error of a tool that a disk or the system has stopped; None for other causes."""
    if error.errno not in _OF_THE_DISK:
        return None
    file = error.filename or "a file"
    return RunFailed(f"{file} can't be read or written ({error.strerror}): {remedy(error)}")


def fault(error: Exception) -> str:
    """Return the line on an exception: kind, text, file, place in the code, and what to do."""
    text = shown(str(error))
    what = f"{type(error).__name__}: {text}" if text else type(error).__name__
    if file := getattr(error, "filename", None):
        what += f" (file {shown(str(file))})"
    return (
        f"a fault of Flock: {what}{_place(error)}; set {TRACEBACK}=1 to see the traceback, and "
        "report this line and the command to the authors of Flock"
    )


def _place(error: Exception) -> str:
    """Return the innermost place of the traceback in Flock, or else the innermost one."""
    import traceback  # for faults only

    places = traceback.extract_tb(error.__traceback__, limit=-100)  # a recursion has thousands
    ours = [
        place
        for place in places
        if PACKAGES & set(Path(place.filename).parts) and place.name != "run_tool"
    ]
    for place in reversed(ours or places):
        file = "/".join(Path(place.filename).parts[-3:])
        return f", at {file}:{place.lineno} in {place.name}"
    return ""

# SPDX-License-Identifier: Apache-2.0
"""The exception for errors that the user can correct, and hints for its message."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Mapping, Sequence


class FlockError(Exception):
    """Bad input, or a run that failed for a reason that one line can explain.

    The message names the value, the allowed range and the fix; the command line prints it after
    `error: ` and exits with `exit_status`: 2 for bad input, 1 for a run that failed.
    """

    exit_status = 2


class RunFailed(FlockError):
    """A run that started and could not be finished: exit status 1."""

    exit_status = 1


_REMEDIES = {
    errno.ENOSPC: "free disk space",
    errno.EDQUOT: "free space of your quota",
    errno.EMFILE: "allow more open files (ulimit -n)",
    errno.ENFILE: "close files of other programs",
}


def remedy(error: OSError) -> str:
    """Return what the user can do about a file that can't be read or written."""
    return _REMEDIES.get(error.errno or 0, "check the disk")


def nearest(word: str, known: Iterable[str], synonyms: Mapping[str, str] | None = None) -> str:
    """Return the hint of an error message: the known word nearest to `word`, and all of them.

    `synonyms` has known words by others for the same.
    """
    known = list(known)
    close = closest(word, known, synonyms)
    hint = f"did you mean {close!r}? " if close else ""
    return f"{hint}known are {', '.join(known)}"


def closest(
    word: str, known: Sequence[str], synonyms: Mapping[str, str] | None = None
) -> str | None:
    """Return the known word nearest to `word`, or with which it begins; None if none is near."""
    import difflib  # for errors only

    if synonyms and word in synonyms:
        return synonyms[word]
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    begins = [each for each in known if each and word.startswith(each)]
    return next(iter(close or begins), None)

# SPDX-License-Identifier: Apache-2.0
"""The one exception that Flock raises for what its user can mend."""


class FlockError(Exception):
    """Bad input or a run that failed for a reason worth one clear line.

    The message names the value, the allowed range and the fix; the command line prints it after
    `error: ` and exits with `exit_status`: 2 for bad input, 1 for a run that failed.
    """

    exit_status = 2


class RunFailed(FlockError):
    """A run that began well and could not be finished: exit status 1."""

    exit_status = 1

# SPDX-License-Identifier: Apache-2.0
"""What only one process of a machine may have at a time.

It is claimed by a name in the kernel's abstract socket namespace, which is free again when its
holder ends, however it does. Where a system has no such namespace, nothing can be claimed.
"""

from __future__ import annotations

import socket


def claimed(claim: socket.socket, what: str) -> bool:
    """Whether `claim`, a Unix socket, has `what` from now on until it is closed."""
    try:
        claim.bind(f"\0flock-{what}")
    except OSError:
        return False
    return True

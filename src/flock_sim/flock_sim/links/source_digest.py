# SPDX-License-Identifier: Apache-2.0
"""The digest of a source file, which identifies a law or a link model of one's own."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any


def digest_of_source(source: bytes) -> str:
    """Return the digest of a source: "sha256:" and 64 hexadecimal digits."""
    return f"sha256:{hashlib.sha256(source).hexdigest()}"


def source_digest(function: Callable[..., Any]) -> str:
    """Return the digest of the file that defines a function; "" if it can't be read."""
    try:
        file = inspect.getsourcefile(inspect.unwrap(function))
        return digest_of_source(Path(file).read_bytes()) if file else ""
    except (OSError, TypeError):
        return ""

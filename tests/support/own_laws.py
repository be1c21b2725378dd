# SPDX-License-Identifier: Apache-2.0
"""Files with laws of one's own, as a user writes them."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent
from typing import Any

from flock_sim.configuration.flock_configuration import FlockConfiguration


def law_file(directory: Path, source: str, name: str = "laws.py") -> Path:
    """Write a file of laws; return its path."""
    path = directory / name
    path.write_text(dedent(source), encoding="utf-8")
    return path


def with_law(
    directory: Path, source: str, term: str, bird: int | None = None, **flock: Any
) -> FlockConfiguration:
    """Return a flock with a law of a new file: `term` is LAW[:KEY=VALUE,...]; None: all birds."""
    target = "" if bird is None else f"{bird}="
    entry = f"{target}{law_file(directory, source)}:{term}"
    return FlockConfiguration.given({"forcing": [entry], **flock})

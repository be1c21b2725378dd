# SPDX-License-Identifier: Apache-2.0
"""JSON from outside, of limited length and depth."""

from __future__ import annotations

import json
import re
from typing import Any

DEEPEST = 64
"""Deepest nesting of arrays and objects."""

LONGEST = 64 * 2**20
"""Longest text, in characters: span ratios of 501 birds with 10^4 members have 25 million."""

_TOKEN = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?|([\[{])|([\]}])', re.DOTALL)
"""A string, an opening bracket or a closing bracket. A string may lack its end: each character is
then still looked at once."""


def parse(text: str) -> Any:
    """Return the value of a JSON text. Raises ValueError if it is invalid or exceeds a limit."""
    if len(text) > LONGEST:
        raise ValueError(f"a JSON text of {len(text)} characters; {LONGEST} are the limit")
    depth = 0
    for token in _TOKEN.finditer(text):
        depth += (token[1] is not None) - (token[2] is not None)
        if depth > DEEPEST:
            raise ValueError(f"a JSON text is nested too deep; {DEEPEST} levels are the limit")
    return json.loads(text)

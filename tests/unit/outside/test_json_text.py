# SPDX-License-Identifier: Apache-2.0
"""JSON is read within limits of depth and length; everything else is a ValueError."""

from __future__ import annotations

import pytest

from flock_sim.outside import json_text
from flock_sim.outside.json_text import parse


def test_json_is_read() -> None:
    assert parse(r'{"a": [1, 2.5, null, "x\"[[\\"]}') == {"a": [1, 2.5, None, 'x"[[\\']}
    assert parse("[" * 64 + "]" * 64)
    assert parse('"' + "[" * 1000 + '"') == "[" * 1000


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "nested too deep; 64 levels are the limit"),
        ('{"a":' * 100_000, "nested too deep"),
        ("9" * 5000, "digits"),
        ('"' + '\\"' * 1_000_000, "Unterminated string"),
        ("{", "Expecting"),
        ("", "Expecting"),
    ],
    ids=range(6),
)
def test_what_is_no_json_or_exceeds_a_limit_is_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse(text)


def test_a_text_above_the_limit_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_text, "LONGEST", 3)
    assert parse("123") == 123
    with pytest.raises(ValueError, match="4 characters; 3 are the limit"):
        parse("1234")

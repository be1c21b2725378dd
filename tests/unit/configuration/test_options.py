# SPDX-License-Identifier: Apache-2.0
"""The options of the flock in the help of the tools."""

from __future__ import annotations

import re

from flock_sim.configuration.options import FLIGHT, FLOCK_OPTIONS, LINKS_TOLD, add_flock_options
from flock_sim.console.arguments import Parser
from flock_sim.links.keys import KEYS, NUMBERS
from flock_sim.links.registry import BUILT_IN, MODELS


def help_of(*hidden: tuple[str, ...]) -> str:
    parser = Parser("tool", "Do it.", "")
    add_flock_options(parser, *hidden)
    return parser.format_help()


def test_help_lists_the_options_that_have_an_effect() -> None:
    everything = help_of()
    for option in FLOCK_OPTIONS.values():
        assert f"{option} " in everything
    shown = help_of(FLIGHT, ("links", "forcing"))
    options = set(re.findall(r"--[a-z-]+", shown))
    assert options == {"--help", "--config", "--birds", "--span-ratio", "--coupling"}


def test_help_explains_every_model_and_key_of_links_with_unit_and_default() -> None:
    for model in MODELS[:BUILT_IN]:
        assert f"\n  {model.name}  " in LINKS_TOLD
    for key in KEYS:
        assert re.search(rf"\b{key}\b", LINKS_TOLD), key
    rows = re.findall(r"^  (\w+) +(steps|-|b|b, U_min) +(inf|[01]) ", LINKS_TOLD, re.M)
    given = {key: (unit, float(default)) for key, unit, default in rows}
    both = {"noise": ("b, U_min", 0.0), "quantum": ("b, U_min", 0.0)}
    single = {
        key: (one.unit.replace("1", "-"), one.default)
        for key, one in NUMBERS.items()
        if not key.endswith(tuple(both))
    }
    assert given == single | both

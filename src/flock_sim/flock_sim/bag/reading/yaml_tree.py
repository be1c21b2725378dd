# SPDX-License-Identifier: Apache-2.0
"""YAML of bags, as lists, mappings and texts, in linear time and with limited depth."""

from __future__ import annotations

from typing import Any

import yaml

from flock_sim.bag import limits


def yaml_tree(text: str) -> Any:
    """Return a YAML document as lists, mappings and texts. Raises ValueError, yaml.YAMLError.

    It is built from YAML events, since libyaml's loader recurses until the process crashes, and
    merge keys can take the time of any number of copies. An alias is None.
    """
    open_ones: list[list[Any]] = [[]]
    for event in yaml.parse(text, Loader=yaml.CBaseLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            open_ones.append([])
            if len(open_ones) > limits.DEEPEST:
                raise ValueError("it is nested too deeply")
        elif isinstance(event, yaml.ScalarEvent):
            open_ones[-1].append(event.value)
        elif isinstance(event, yaml.AliasEvent):
            open_ones[-1].append(None)  # no needed value is an alias
        elif isinstance(event, yaml.SequenceEndEvent):
            items = open_ones.pop()
            open_ones[-1].append(items)
        elif isinstance(event, yaml.MappingEndEvent):
            items = open_ones.pop()
            pairs = zip(items[::2], items[1::2], strict=True)
            open_ones[-1].append({key: value for key, value in pairs if isinstance(key, str)})
    return open_ones[0][0] if open_ones[0] else None

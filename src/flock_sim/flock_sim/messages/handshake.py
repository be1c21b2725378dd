# SPDX-License-Identifier: Apache-2.0
"""The handshake: every grant carries the whole configuration, on which all nodes must agree."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from typing import Any

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.forcing.registry import digests_of
from flock_sim.outside import json_text

LONGEST_VALUE = 40
"""Most characters of a value that are shown."""


def handshake(
    configuration: FlockConfiguration, factor: float = 0.0, laws: Mapping[str, str] | None = None
) -> str:
    """Return the configuration as JSON; `factor` is the real-time factor of a free flight.

    `laws` are the digests of the laws of one's own; None: of those that this process has loaded.
    """
    flown = configuration.parameters()
    if laws is None:
        laws = digests_of(configuration.forcing_table.names)
    if laws:
        flown["laws"] = dict(laws)
    if factor:
        flown["real_time_factor"] = factor
    return json.dumps(flown, separators=(",", ":"))


def read_handshake(said: str) -> tuple[FlockConfiguration, float]:
    """Return the configuration in a clock's terms, and the real-time factor; 0 in lockstep.

    Raises FlockError if this version of Flock can't fly the configuration. Raises ValueError if
    `said` is not the text of terms.
    """
    flown = _object(said)
    factor = flown.pop("real_time_factor", 0.0)
    flown.pop("laws", None)
    number = isinstance(factor, int | float) and not isinstance(factor, bool)
    if not number or not 0.0 <= factor <= sys.float_info.max:
        raise ValueError(f"terms: the real-time factor {_shown(factor)} is not a positive number")
    return FlockConfiguration.from_parameters(flown), float(factor)


def run_id_of(configuration: FlockConfiguration) -> int:
    """Return the default run id of a flight, 1 .. 2**63 - 1, computed from its configuration.

    A restarted clock thus has the run id of its flock.
    """
    digest = hashlib.blake2b(handshake(configuration).encode(), digest_size=8).digest()
    return 1 + int.from_bytes(digest, "little") % (2**63 - 1)


def check_handshake(
    who: str,
    configuration: FlockConfiguration,
    said: str,
    factor: float = 0.0,
    laws: Mapping[str, str] | None = None,
) -> None:
    """Raise FlockError if the clock's terms, `said`, differ from those of the node `who`.

    The error names the differences. `factor` is the real-time factor of the node, 0 in lockstep;
    `laws` are as in `handshake`.

    Raises ValueError if `said` is not the text of terms.
    """
    expected = handshake(configuration, factor, laws)
    if said == expected:
        return
    theirs = _object(said)
    ours = json_text.parse(expected)
    different = [
        f"{key} = {_shown(ours.get(key))} where the clock has {_shown(theirs.get(key))}"
        for key in {**ours, **theirs}
        if ours.get(key) != theirs.get(key)
    ]
    if not different:
        return
    raise FlockError(f"{who} has {', '.join(different)}: give both the same configuration")


def _object(said: str) -> dict[str, Any]:
    """Return the JSON object that `said` is. Raises ValueError if it is none."""
    found = json_text.parse(said)
    if not isinstance(found, dict):
        raise ValueError("terms: not an object")
    return found


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "..."

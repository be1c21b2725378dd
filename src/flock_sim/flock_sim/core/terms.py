# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a flight must agree on: the whole configuration, as text in every grant."""

from __future__ import annotations

import hashlib
import json

from flock_sim.core.configuration import FlockConfiguration
from flock_sim.errors import FlockError

LONGEST_VALUE = 40
"""Characters of a value that are shown of it."""


def terms(configuration: FlockConfiguration, factor: float = 0.0) -> str:
    """Return what is flown, as JSON; `factor` is the real-time factor of a free flight."""
    flown = configuration.parameters()
    if factor:
        flown["real_time_factor"] = factor
    return json.dumps(flown, separators=(",", ":"))


def run_id_of(configuration: FlockConfiguration) -> int:
    """Return the run id of a flight that was given none: 1 .. 2**63 - 1, from what is flown.

    A clock that is started again so finds its flock again.
    """
    digest = hashlib.blake2b(terms(configuration).encode(), digest_size=8).digest()
    return 1 + int.from_bytes(digest, "little") % (2**63 - 1)


def agree(who: str, configuration: FlockConfiguration, said: str, factor: float = 0.0) -> None:
    """Raise FlockError, naming what differs, where the clock's terms `said` are not those of `who`.

    `factor` is the real-time factor of `who`, 0 in lockstep.

    Raises ValueError where `said` are no terms.
    """
    expected = terms(configuration, factor)
    if said == expected:
        return
    try:
        theirs = json.loads(said)
    except RecursionError:
        raise ValueError("terms: too deep") from None
    if not isinstance(theirs, dict):
        raise ValueError("terms: not an object")
    ours = json.loads(expected)
    different = [
        f"{key} = {_shown(ours.get(key))} and not {_shown(theirs.get(key))}"
        for key in {**ours, **theirs}
        if ours.get(key) != theirs.get(key)
    ]
    if not different:
        return
    raise FlockError(
        f"{who} is to fly {', '.join(different)} as the clock does: "
        "give both the same configuration"
    )


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 3] + "..."

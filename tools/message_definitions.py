# SPDX-License-Identifier: Apache-2.0
"""Writes the definitions of Flock's messages into flock_sim, for flights without ROS 2.

`./flock python tools/message_definitions.py`; tests/unit/bag/test_definitions.py checks the file.
"""

from __future__ import annotations

import json

from flock_sim.bag.definitions import COPIES, installed_definition
from flock_sim.messages.types import Message


def main() -> None:
    """Write the file."""
    types = sorted({kind.TYPE for kind in Message.__subclasses__()})
    found = [vars(installed_definition(name)) for name in types]
    COPIES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

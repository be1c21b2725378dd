# SPDX-License-Identifier: Apache-2.0
"""Writes the definitions of the messages in Flock's bags into flock_sim, for use without ROS 2.

`./flock python tools/message_definitions.py`; tests/unit/bag/test_definitions.py checks the file.
"""

from __future__ import annotations

import json

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from flock_sim.bag.definitions import COPIES, Definition, installed_definition
from flock_sim.messages.types import Message
from flock_tools.scene.messages import IMAGE, MARKERS, ODOMETRY, TRANSFORM, TRANSFORMS


def all_definitions() -> list[Definition]:
    """Return the definitions of the messages of flights and scenes, in the order of their types."""
    types = {kind.TYPE for kind in Message.__subclasses__()} | {MARKERS, IMAGE, ODOMETRY, TRANSFORM}
    found = [*map(installed_definition, types), tf_definition()]
    return sorted(found, key=lambda definition: definition.type)


def tf_definition() -> Definition:
    """Return the definition of the messages on /tf. There is no wheel of tf2_msgs."""
    short = TRANSFORM.replace("/msg/", "/")
    nested = installed_definition(TRANSFORM).text
    text = f"{short}[] transforms\n\n{'=' * 80}\nMSG: {short}\n{nested}"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, TRANSFORMS))
    return Definition(TRANSFORMS, text, store.hash_rihs01(TRANSFORMS))


def main() -> None:
    """Write the file."""
    found = [vars(definition) for definition in all_definitions()]
    COPIES.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

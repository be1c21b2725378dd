# SPDX-License-Identifier: Apache-2.0
"""A recorded topic: its name, its type, and the quality of service that its publisher offers."""

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import yaml

Reliability = Literal["reliable", "best_effort", "system_default"]
Durability = Literal["volatile", "transient_local", "system_default"]
History = Literal["keep_last", "keep_all", "system_default"]

# The value in ROS for no deadline, lifespan or lease: the longest time, 2**63 - 1 ns.
_FOREVER = (9223372036, 854775807)


@dataclass(frozen=True)
class Topic:
    """One topic of a bag, with the offered QoS under rmw's own names (no ROS import needed).

    `name` is the full name ("/flock/bird_01/state"), `type` the full type
    ("flock_interfaces/msg/BirdState"), `depth` the history depth in messages.
    """

    name: str
    type: str
    reliability: Reliability = "reliable"
    durability: Durability = "volatile"
    history: History = "keep_last"
    depth: int = 10

    def qos_profiles(self) -> list[dict[str, Any]]:
        """List the offered QoS profiles as in rosbag2's metadata of version 9."""

        def forever() -> dict[str, int]:
            return dict(zip(("sec", "nsec"), _FOREVER, strict=True))

        return [
            {
                "history": self.history,
                "depth": self.depth,
                "reliability": self.reliability,
                "durability": self.durability,
                "deadline": forever(),
                "lifespan": forever(),
                "liveliness": "automatic",
                "liveliness_lease_duration": forever(),
                "avoid_ros_namespace_conventions": False,
            }
        ]

    def qos_text(self) -> str:
        """Return the QoS profiles as YAML text, which rosbag2 puts into a channel's metadata."""
        return _qos_text(self.reliability, self.durability, self.history, self.depth)


@cache  # a flock has hundreds of topics and a handful of profiles
def _qos_text(
    reliability: Reliability, durability: Durability, history: History, depth: int
) -> str:
    profiles = Topic("", "", reliability, durability, history, depth).qos_profiles()
    text: str = yaml.safe_dump(profiles, sort_keys=False)
    return text.rstrip("\n")

# SPDX-License-Identifier: Apache-2.0
"""A laboratory for decentralised formation flight: the physics core and the ROS 2 nodes."""

__version__ = "0.1.0"

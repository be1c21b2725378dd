# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: they move messages between topics and the state machines of `protocol`."""

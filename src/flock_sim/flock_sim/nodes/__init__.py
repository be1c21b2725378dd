# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: thin shells that move messages between topics and the core's state machines."""

EXECUTORS = ("events", "single")
"""Executors of rclpy that nodes can be served by; the first is the default."""

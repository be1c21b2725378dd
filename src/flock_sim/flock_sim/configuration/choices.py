# SPDX-License-Identifier: Apache-2.0
"""The words that a key of the configuration or an option accepts; the first is the default."""

COUPLINGS = ("nearest", "all")
"""The birds whose wakes act on a bird: its nearest neighbours, or all others."""

MODES = ("lockstep", "free")
"""Birds wait for each other's messages, which is exact, or step by their own timers."""

EXECUTORS = ("events", "single")
"""Executors of rclpy that can serve a node."""

# SPDX-License-Identifier: Apache-2.0
"""Reasons to ignore a received message, in the words of warnings and `/diagnostics`."""

FOREIGN = "of another run"
STRANGE = "not from a neighbour"
MISSHAPEN = "of a wrong length"
MALFORMED = "that can't be read"
STALE = "of an epoch that is over"
AGAIN = "that were heard before"
REPEATED = "for a stage already passed or out of reach"
IMPOSSIBLE = "with values that the sender can't have"

# SPDX-License-Identifier: Apache-2.0
"""Reasons to ignore a received message, in the words of warnings and `/diagnostics`."""

FOREIGN = "of another run"
STRANGE = "not from a neighbour"
MISSHAPEN = "with a wrong length"
MALFORMED = "that can't be read"
STALE = "of an epoch that is over"
AGAIN = "that were received before"
REPEATED = "for a step or stage that is over or too far ahead"
IMPOSSIBLE = "with invalid values"

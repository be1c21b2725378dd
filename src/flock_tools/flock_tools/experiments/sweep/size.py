# SPDX-License-Identifier: Apache-2.0
"""How many members a sweep has, and how many fly at once."""

MOST_MEMBERS = 100_000
"""Largest number of members of a sweep."""

AT_ONCE = 250
"""Members per flight: many, so that messages cost little, but few enough for small bags."""

LANES = 8
"""Members per part: a single member costs twice as much, and more keep fewer cores busy."""

PART_NUMBERS = 10_000_000
"""Largest amount of recorded numbers of a part of more than one member: 80 MB of memory."""

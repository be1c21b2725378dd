# SPDX-License-Identifier: Apache-2.0
"""Players are told from birds, and one player from the next."""

from __future__ import annotations

import math

from flock_tools.live.players import Players, Publisher

FIRST = Publisher("/flock/player", (1,))
SECOND = Publisher("/flock/player", (2,))
CLOCK = Publisher("/flock/clock", (3,))


def bird(number: int) -> Publisher:
    return Publisher(f"/flock/bird_{number:02d}", (3,))


def test_a_bird_is_no_player() -> None:
    players = Players()
    players.look({1: {bird(1)}, 2: {bird(2)}}, {CLOCK}, 1.0)
    assert (players.birds, players.grant, players.since) == (frozenset(), True, -math.inf)
    players.look({1: {bird(1), FIRST}, 2: {bird(2)}}, {CLOCK}, 2.0)
    assert (players.birds, players.grant, players.since) == ({1}, False, 1.0)
    assert players.clock


def test_a_player_that_was_there_first_has_played_all_that_was_heard() -> None:
    players = Players()
    players.look({1: {FIRST}}, {FIRST}, 5.0)
    assert (players.grant, players.since) == (True, -math.inf)
    assert not players.clock


def test_the_next_player_begins_after_the_last_look_without_it() -> None:
    players = Players()
    players.look({1: {FIRST}, 2: {FIRST}}, {FIRST}, 1.0)
    players.look({}, set(), 2.0)
    assert (players.birds, players.grant) == ({1, 2}, True)  # its last messages may be on the way
    players.look({1: {SECOND}}, set(), 3.0)
    assert (players.birds, players.grant, players.since) == ({1}, False, 2.0)
    players.look({1: {SECOND}}, {SECOND}, 4.0)  # its topics are discovered one by one
    assert (players.grant, players.since) == (True, 2.0)


def test_a_player_without_a_name_yet_is_there_already() -> None:
    players = Players()
    players.look({}, set(), 1.0)
    players.look({1: {Publisher("", SECOND.participant)}}, set(), 2.0)
    assert players.birds == frozenset()
    players.look({1: {SECOND}}, set(), 3.0)
    assert (players.birds, players.since) == ({1}, 1.0)


def test_other_publishers_that_come_and_go_do_not_end_a_playback() -> None:
    players = Players()
    players.look({1: {FIRST}}, {FIRST}, 1.0)
    players.look({1: {FIRST, bird(1)}}, {FIRST, CLOCK}, 2.0)
    players.look({1: {FIRST, SECOND}}, {FIRST}, 3.0)
    assert players.since == 2.0
    players.look({1: {FIRST}}, {FIRST}, 4.0)
    assert players.since == -math.inf

# SPDX-License-Identifier: Apache-2.0
"""The bag has the memories of birds that a resumption needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flock_sim.bag.writing.writer import BagWriter
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.launcher.reference_flight import row as row_of
from flock_sim.messages import topics
from flock_sim.messages.types import Memory
from flock_sim.recording.flight_writer import recording
from flock_sim.recording.row_assembler import Row
from flock_sim.recording.run import Run
from flock_sim.reference.integrator import Reference

CONFIGURATION = FlockConfiguration(
    birds=3, t_max=20.0, record_every=2, links=("1->2=hold:delay=3", "2->3=linear:drop=0.2")
)
REMEMBER = (2, 3)


def with_memories(row: Row) -> Row:
    link_table = CONFIGURATION.link_table
    memories = [
        Memory(9, row.step, 3, bird, np.full(link_table.remembers(bird), float(row.step))).encode()
        for bird in REMEMBER
    ]
    return Row(row.step, row.wings, row.stages, row.time, row.states, memories)


ROWS = [with_memories(row_of(CONFIGURATION, state)) for state in Reference(CONFIGURATION).fly()]


def remembered(directory: Path) -> list[int]:
    """The steps for which the bag has the memories of both birds."""
    with Run(directory) as run:
        names = [topics.memory_topic(bird) for bird in REMEMBER]
        found = [(topic, Memory.decode(data).step) for topic, _, data in run.bag.messages(names)]
    steps = [[step for topic, step in found if topic == name] for name in names]
    assert steps[0] == steps[1]
    return steps[0]


def test_only_the_last_row_before_it_is_made_safe_is_remembered(tmp_path: Path) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        for row in ROWS[:4]:
            run.write_row(row)
        assert run.saved == -1
        run.flush()
        assert run.saved == ROWS[3].step
        assert (run.checkpoint, run.memories) == (ROWS[3].states, ROWS[3].memories)
        run.flush()
        for row in ROWS[4:]:
            run.write_row(row)
    assert remembered(tmp_path / "bag") == [ROWS[3].step, ROWS[-1].step]


def test_a_row_on_disk_without_memories_is_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 1)  # a row, a chunk
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_row(ROWS[0])
        run.write_row(ROWS[1])
        run.flush()
        run.write_row(ROWS[2])
        run.write_row(ROWS[3])  # on disk, as the kill finds it
        assert run.saved == ROWS[1].step
        run.bag.leave()
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert run.saved == ROWS[1].step
        assert (run.checkpoint, run.memories) == (ROWS[1].states, ROWS[1].memories)
        for row in ROWS[2:]:
            run.write_row(row)
    with Run(tmp_path / "bag") as flown:
        assert [snapshot.step for snapshot in flown.snapshots()] == [row.step for row in ROWS]
    assert remembered(tmp_path / "bag") == [ROWS[1].step, ROWS[-1].step]


def test_a_row_whose_memories_are_not_all_there_is_flown_again(tmp_path: Path) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=True) as run:
        run.write_row(ROWS[0])
        run.flush()
        run.write_row(ROWS[1])
        run.bag.write(topics.memory_topic(2), 0, ROWS[1].memories[0])
        run.bag.leave()
    with recording(tmp_path / "bag", CONFIGURATION, grants=True, resume=True) as run:
        assert run.saved == ROWS[0].step


def test_flights_over_plain_links_have_no_topic_of_memories(tmp_path: Path) -> None:
    plain = FlockConfiguration(birds=3, t_max=4.0, links=("exact",))
    with recording(tmp_path / "plain", plain, grants=True):
        pass
    with Run(tmp_path / "plain") as run:
        assert not [name for name in run.bag.topics if name.endswith("/memory")]


def test_the_reference_needs_no_memory_in_its_bag(tmp_path: Path) -> None:
    with recording(tmp_path / "bag", CONFIGURATION, grants=False) as run:
        for row in ROWS:
            run.write_row(Row(row.step, row.wings, row.stages, row.time, row.states))
        run.flush()
        assert run.saved == ROWS[-1].step

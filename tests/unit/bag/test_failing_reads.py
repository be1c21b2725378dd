# SPDX-License-Identifier: Apache-2.0
"""A bag on a disk that fails is refused with its name, whichever system call fails."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zstandard
from mcap.writer import Writer

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from support.flights import record

CALLS = ("pread", "fstat")
"""The functions of `os` by which bags are read."""


@contextmanager
def failing(number: int) -> Iterator[list[int]]:
    """Let the call of this number fail in the block, from 0 on; give the number of calls so far."""
    count = [0]

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def replaced(*arguments: Any) -> Any:
            count[0] += 1
            if count[0] == number + 1:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return call(*arguments)

        return replaced

    with pytest.MonkeyPatch.context() as patch:
        for name in CALLS:
            patch.setattr(os, name, counted(getattr(os, name)))
        yield count


def read_all(path: Path) -> None:
    """Read a bag in all ways."""
    with BagReader(path) as bag:
        assert list(bag.messages())
        assert list(bag.by_time(bag.streams))
        assert bag.latest(dict.fromkeys(bag.streams, 1), 1 << 60)
        assert list(bag.salvage([]))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    configuration = FlockConfiguration(birds=2, t_max=100.0)
    return record(tmp_path_factory.mktemp("flight") / "bag", configuration)


@pytest.mark.parametrize("kind", ["whole", "torn", "packed", "loose"])
def test_whichever_call_fails_the_file_is_named(flight: Path, tmp_path: Path, kind: str) -> None:
    file = tmp_path / "bag_0.mcap"
    data = (flight / "bag_0.mcap").read_bytes()
    if kind == "loose":
        with file.open("wb") as opened:
            writer = Writer(opened, use_chunking=False)
            writer.start()
            channel = writer.register_channel("/chatter", "cdr", 0)
            for k in range(5):
                writer.add_message(channel, k, b"word", k)
            writer.finish()
    else:
        whole = data if kind != "torn" else data[: len(data) * 4 // 5]
        file.write_bytes(zstandard.compress(whole) if kind == "packed" else whole)
    with failing(-1) as count:
        read_all(file)
    assert count[0] > 10
    for number in range(count[0]):
        with failing(number), pytest.raises(FlockError) as told:
            read_all(file)
        assert str(file) in str(told.value), number
        assert "Input/output error" in str(told.value), number

# SPDX-License-Identifier: Apache-2.0
"""Regular files are opened, and nothing else; opening never waits."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from flock_sim.outside.regular_file import NotRegularError, open_file, read_file
from support.hanging import not_hanging


def test_a_file_is_read_up_to_one_byte_beyond_the_limit(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_bytes(b"abcdef")
    assert read_file(file, 6) == b"abcdef"
    assert read_file(file, 3) == b"abcd"
    with open_file(file) as opened:
        assert os.pread(opened.fileno(), 2, 1) == b"bc"


def test_a_file_that_does_not_tell_its_size_is_read_to_its_end() -> None:
    maps = Path("/proc/self/maps")
    assert maps.stat().st_size == 0
    assert read_file(maps, 2**20).endswith(b"\n")


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("pipe", "is a named pipe, which has no end"),
        (".", "Is a directory"),
        ("/dev/null", "is a device, which has no end"),
    ],
)
def test_other_files_are_refused_without_a_wait(tmp_path: Path, path: str, kind: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NotRegularError) as caught, not_hanging():
        open_file(tmp_path / path)
    assert caught.value.strerror == kind


def test_no_file_stays_open_after_a_refusal(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(NotRegularError):
        open_file(tmp_path / "pipe")
    assert os.listdir("/proc/self/fd") == before


@pytest.mark.parametrize("name", ["a\0b", "a\ud800b"])
def test_a_name_that_no_file_can_have_is_an_oserror(name: str) -> None:
    with pytest.raises(OSError, match="its name is invalid"):
        open_file(Path(name))

# SPDX-License-Identifier: Apache-2.0
"""A file of a user is read if it is a regular file of UTF-8 text and of limited size."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from flock_sim.errors import FlockError
from flock_sim.outside import text
from support.hanging import not_hanging


def test_a_text_is_read_without_its_byte_order_mark(tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_bytes(b"\xef\xbb\xbfbirds: \xce\xb7\n")
    assert text.read_text(file, "sweep file") == "birds: η\n"


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("/dev/zero", "is a device, which has no end"),
        ("/dev/random", "is a device, which has no end"),
        ("pipe", "is a named pipe, which has no end"),
        ("link", "is a named pipe, which has no end"),
        (".", "Is a directory"),
        ("missing", "No such file or directory"),
        ("x" * 300, "File name too long"),
        ("a\0b", "its name is invalid"),
        ("a\ud800b", "its name is invalid"),
        ("loop", "Too many levels of symbolic links"),
        ("latin", r"it is not UTF-8 text \(line 2\)"),
    ],
)
def test_what_is_no_regular_file_of_text_is_refused(tmp_path: Path, path: str, said: str) -> None:
    os.mkfifo(tmp_path / "pipe")  # no process writes to it: a read would wait for ever
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "latin").write_bytes(b"a\ncaf\xe9\n")
    with (
        pytest.raises(FlockError, match=f"^sweep file .*: {said}.*; name a readable sweep file$"),
        not_hanging(),
    ):
        text.read_text(tmp_path / path, "sweep file")


def test_a_file_above_the_limit_is_refused_with_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "large"
    with file.open("wb") as opened:
        opened.truncate(text.LARGEST_FILE + 1)
    with pytest.raises(FlockError, match=r"large: is larger than 64 MiB, the limit"):
        text.read_bytes(file, "law file")
    monkeypatch.setattr(text, "LARGEST_FILE", 3)
    file.write_bytes(b"abc")
    assert text.read_bytes(file, "law file") == b"abc"

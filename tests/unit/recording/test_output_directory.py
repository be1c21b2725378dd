# SPDX-License-Identifier: Apache-2.0
"""Output directories: which are accepted, which are refused, and that refusals change nothing."""

import errno
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from flock_sim.errors import FlockError, RunFailed
from flock_sim.recording.output_directory import (
    Output,
    own_new_output,
    own_output,
    remove_bag,
)


def tree(root: Path) -> dict[str, bytes | None]:
    return {
        str(path.relative_to(root)): path.read_bytes() if path.is_file() else None
        for path in sorted(root.rglob("*"))
    }


def make_bag(directory: Path, *names: str) -> Path:
    directory.mkdir(parents=True)
    for name in names:
        (directory / name).write_text(name)
    return directory


def test_a_new_output_is_made_with_its_parents(tmp_path: Path) -> None:
    with own_output(tmp_path / "runs" / "today" / "one", force=False) as output:
        assert tree(tmp_path) == {"runs": None, "runs/today": None, "runs/today/one": None}
        assert not output.replaces
    assert tree(tmp_path) == {"runs": None, "runs/today": None}  # nothing was put into it


@pytest.mark.parametrize("names", [(), ("metadata.yaml", "out_0.mcap"), ("thesis.tex",)])
def test_what_exists_is_refused_without_force(tmp_path: Path, names: tuple[str, ...]) -> None:
    output = make_bag(tmp_path / "out", *names)
    before = tree(tmp_path)
    with pytest.raises(FlockError, match=r"out exists: add --force .* or name another --output"):
        own_output(output, force=False)
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    "names",
    [
        (),
        ("metadata.yaml", "out_0.mcap"),
        ("metadata.yaml", "out_0.mcap", "formation.png"),
        ("metadata.yaml", "out_0.mcap", "formation.png", "formation_member_2.png"),
        ("metadata.yaml", "out_0.mcap", "out_1.mcap"),
        ("out_0.mcap", ".reserve"),
        ("metadata.yaml",),
        (".reserve",),
    ],
)
def test_force_takes_a_bag_which_stays_until_it_is_removed(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    bag = make_bag(tmp_path / "out", *names)
    before = tree(tmp_path)
    with own_output(bag, force=True) as output:
        assert output.replaces == (names != ())
    assert tree(tmp_path) == before
    remove_bag(bag)
    assert tree(tmp_path) == {}


@pytest.mark.parametrize(
    "names",
    [
        ("thesis.tex",),
        ("one.mcap", "two.mcap"),
        (".git",),
        ("metadata.yaml", "thesis.tex"),
        ("notes.mcap.txt",),
    ],
)
def test_force_refuses_a_directory_that_is_no_bag(tmp_path: Path, names: tuple[str, ...]) -> None:
    output = make_bag(tmp_path / "out", *names)
    before = tree(tmp_path)
    with pytest.raises(FlockError, match="out is not a bag"):
        own_output(output, force=True)
    assert tree(tmp_path) == before


def test_force_refuses_a_bag_with_directories_in_it(tmp_path: Path) -> None:
    output = make_bag(tmp_path / "out", "metadata.yaml", "out_0.mcap")
    make_bag(output / "chapters", "one.tex")
    before = tree(tmp_path)
    with pytest.raises(FlockError, match="out is not a bag"):
        own_output(output, force=True)
    assert tree(tmp_path) == before


def test_force_refuses_a_file(tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    output.write_text("dear")
    with pytest.raises(FlockError, match="not a directory"):
        own_output(output, force=True)
    assert output.read_text() == "dear"


@pytest.mark.parametrize("force", [False, True])
def test_an_output_below_a_file_is_refused(tmp_path: Path, force: bool) -> None:
    (tmp_path / "file").write_text("dear")
    with pytest.raises(FlockError, match="can't be written"):
        own_output(tmp_path / "file" / "out", force)
    assert tree(tmp_path) == {"file": b"dear"}


def test_an_output_that_fails_halfway_leaves_no_parents(tmp_path: Path) -> None:
    with pytest.raises(FlockError, match="File name too long"):
        own_output(tmp_path / "a" / "b" / ("x" * 300) / "run", force=False)
    assert tree(tmp_path) == {}


def test_an_output_without_permission_is_refused(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write everywhere")
    locked = make_bag(tmp_path / "locked")
    empty = make_bag(locked / "empty")
    for directory in (empty, locked):
        directory.chmod(0o555)
    try:
        for output, force in ((locked / "new", False), (empty, True)):
            with pytest.raises(FlockError, match=r"Permission denied.*name another --output"):
                own_output(output, force)
    finally:
        locked.chmod(0o755)


@pytest.mark.parametrize("own", [partial(own_output, force=False), own_new_output])
def test_a_new_output_that_cant_be_opened_is_refused_and_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own: Callable[[Path], Output]
) -> None:
    def refuse(*arguments: object) -> int:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(FlockError, match=r"one can't be written \(Too many open files\)"):
        own(tmp_path / "runs" / "one")
    assert tree(tmp_path) == {}


def test_an_output_that_cant_be_read_at_the_end_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(path: object) -> os.stat_result:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with own_output(tmp_path / "one", force=False) as output:
        with monkeypatch.context() as broken:
            broken.setattr(os, "stat", fail)
            with pytest.raises(RunFailed, match=r"can't be read \(Input/output error\)"):
                output.check()
        output.path.rmdir()
        with pytest.raises(RunFailed, match="moved or removed"):
            output.check()

# SPDX-License-Identifier: Apache-2.0
"""`make setup` and ./flock detect parts that are missing, damaged or older than the sources.

The project's scripts run in a tree in which a substitute for Python, pip and colcon creates a few
files.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

STAND_IN = r"""#!/usr/bin/env bash
set -e
leave() { mkdir -p "$(dirname "$1")"; echo "$2" >"$1"; }
case "$*" in
    *sys.executable*) echo "$STAND_IN" ;;
    -c*) ;;
    "-m venv .venv") mkdir -p .venv/bin; cp "$0" .venv/bin/python ;;
    "-m pip install"*)
        ! grep -qs "${!#}" no-network || { echo "no network"; exit 1; }
        leave .venv/lib/python3.11/site-packages/numpy/__init__.py code
        leave .venv/share/rosidl_adapter/cmake/rosidl_adapt_interfaces.cmake \
            '  file(STRINGS "${idl_output}" idl_tuples)' ;;
    "-m compileall"*) ;;
    "-m colcon build"*)
        [ ! -e edit-while-building ] || cat edit-while-building >>src/flock_interfaces/msg/Grant.msg
        for package in flock_interfaces flock_sim flock_tools; do
            leave "build/$package/built" "$package"
            leave "install/$package/share/$package/package.sh" "$package"
        done
        leave install/flock_sim/lib/flock_sim/fly tool
        ln -sf "$PWD/src/flock_interfaces/msg/Grant.msg" install/flock_interfaces/share ;;
    "-m flock_sim.launcher.precompile")
        leave src/flock_sim/flock_sim/__pycache__/kernels/digest/a.kernel code ;;
    "-P -S "*/tools/start_tool*) echo "ran ${4##*/}" ;;
    *) echo "ran ${1##*/}" ;;
esac
"""

PHASES = ("Python packages", "colcon workspace", "compiled kernels")
OLDER = "is older than its sources: run `make setup` there"

Run = Callable[..., "subprocess.CompletedProcess[str]"]


class Tree:
    """A tree with the scripts of the project and a few sources."""

    def __init__(self, root: Path, stand_in: Path) -> None:
        """Make one in `root`."""
        self.root = root
        self.search_path = f"{stand_in}:{os.environ['PATH']}"
        self._environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("ROS_", "AMENT_", "PYTHON"))
        }
        self._environment |= {
            "PYTHON": str(stand_in / "python"),
            "STAND_IN": str(stand_in / "python"),
            "PATH": self.search_path,
        }
        root.mkdir(parents=True)
        for name in ("flock", "colcon.meta"):
            shutil.copy(ROOT / name, root)
        shutil.copytree(ROOT / "tools", root / "tools")
        for name in ("requirements/ros-jazzy.txt", "requirements/run.txt", "requirements/dev.txt"):
            self.write(name, "a==1\n")
        for package in ("flock_interfaces", "flock_sim", "flock_tools"):
            self.write(f"src/{package}/package.xml", "<package/>\n")
        self.write("src/flock_interfaces/msg/Grant.msg", "uint64 run_id\n")
        self.write("src/flock_interfaces/CMakeLists.txt", "project(flock_interfaces)\n")
        self.write("src/flock_sim/setup.py", "setup()\n")
        self.write("src/flock_sim/flock_sim/core.py", "x = 1\n")

    def write(self, name: str, text: str) -> Path:
        """Write a file of the tree."""
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    def run(self, *command: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run a command of the tree."""
        return subprocess.run(
            [str(self.root / command[0]), *command[1:]],
            env=self._environment | environment,
            capture_output=True,
            text=True,
            check=False,
        )

    def set_up(self) -> list[str]:
        """Set up; return the phases that were run, by the first of PHASES they are."""
        done = self.run("tools/setup")
        assert done.returncode == 0, done.stdout + done.stderr
        return [p for p in PHASES for line in done.stdout.splitlines() if f": {p}" in line]

    def fly(self) -> tuple[int, str]:
        """Run a tool; return its status and all that was said."""
        done = self.run("flock", "fly")
        return done.returncode, (done.stdout + done.stderr).strip()


FLIES = (0, "ran fly")


@pytest.fixture
def stand_in(tmp_path: Path) -> Path:
    """Return a directory with a Python and what else a machine has to bring."""
    directory = tmp_path / "stand-in"
    directory.mkdir()
    for name in ("python", "cc", "c++", "cmake", "make"):
        (directory / name).write_text(STAND_IN, encoding="utf-8")
        (directory / name).chmod(0o755)
    return directory


@pytest.fixture
def tree(tmp_path: Path, stand_in: Path) -> Tree:
    """Return a tree that is set up."""
    tree = Tree(tmp_path / "tree", stand_in)
    assert tree.set_up() == list(PHASES)
    assert tree.fly() == FLIES
    return tree


def test_what_is_set_up_is_left_alone(tree: Tree) -> None:
    assert tree.set_up() == []


def test_an_edit_that_needs_a_build_is_noticed(tree: Tree) -> None:
    for name in (
        "src/flock_interfaces/msg/Grant.msg",
        "src/flock_interfaces/CMakeLists.txt",
        "src/flock_sim/setup.py",
        "src/flock_tools/package.xml",
        "requirements/run.txt",
        "colcon.meta",
    ):
        path = tree.root / name
        before, text = path.stat(), path.read_text("utf-8")
        tree.write(name, text.swapcase())
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))  # as a copied file has them
        assert tree.fly() == (2, f"error: Flock in {tree.root} {OLDER}"), name
        tree.write(name, text)
        assert tree.fly() == FLIES, name
    tree.write("src/flock_interfaces/srv/New.srv", "---\n")
    assert tree.fly()[1].endswith(OLDER)
    assert tree.set_up() == [PHASES[1]]
    (tree.root / "src" / "flock_interfaces" / "srv" / "New.srv").unlink()
    assert tree.fly()[1].endswith(OLDER)


def test_an_edit_that_needs_no_build_stops_nothing(tree: Tree) -> None:
    for name in (
        "src/flock_sim/flock_sim/core.py",
        "src/flock_sim/flock_sim/.core.py.swp",
        "src/flock_interfaces/msg/Grant.msg~",
        "requirements/docs.txt",
    ):
        tree.write(name, "x = 2\n")
    assert tree.fly() == FLIES


def test_sources_that_were_only_touched_are_as_they_were(tree: Tree) -> None:
    path = tree.root / "src" / "flock_interfaces" / "msg" / "Grant.msg"
    seen = tree.root / "build" / "flock-sources"
    for _ in range(2):
        path.write_bytes(path.read_bytes())
        before = seen.read_text("utf-8")
        assert tree.fly() == FLIES
        assert seen.read_text("utf-8") != before  # next time, times are enough


def test_an_edit_during_the_build_makes_the_workspace_stale(tree: Tree) -> None:
    tree.write("edit-while-building", "uint64 more\n")
    tree.write("src/flock_interfaces/msg/Grant.msg", "uint64 run\n")
    tree.set_up()
    (tree.root / "edit-while-building").unlink()
    assert tree.fly()[1].endswith(OLDER)
    assert tree.set_up() == [PHASES[1]]
    assert tree.fly() == FLIES


def test_an_edit_of_any_module_of_the_package_makes_the_kernels_stale(tree: Tree) -> None:
    tree.write("src/flock_sim/flock_sim/nodes/new.py", "x = 1\n")
    assert tree.set_up() == [PHASES[2]]


def test_what_is_missing_is_made_again(tree: Tree) -> None:
    code = ".venv/lib/python3.11/site-packages/numpy/__init__.py"
    tool = "install/flock_sim/lib/flock_sim/fly"
    cases = {
        code: PHASES[0],
        ".venv/bin": PHASES[0],
        tool: PHASES[1],
        "install": PHASES[1],
        "install/flock_interfaces/share/Grant.msg": PHASES[1],
        "build/flock_tools": PHASES[1],
        "build": PHASES[1],
        "src/flock_sim/flock_sim/__pycache__": PHASES[2],
    }
    for name, phase in cases.items():
        path = tree.root / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        if name in (tool, "install"):
            said = f"error: Flock in {tree.root} lacks the tool `fly`: run `make setup` there"
            assert tree.fly() == (2, said)
        assert tree.set_up() == [phase], name
    for name in (code, tool):
        tree.write(name, "")
        assert tree.set_up() == [cases[name]], name
    assert tree.fly() == FLIES


def test_a_removal_that_was_interrupted_leaves_no_whole_environment(tree: Tree) -> None:
    # Another Python is asked for: the environment has to be removed, and half of it is.
    stub = tree.root / "stub"
    stub.mkdir()
    (stub / "rm").write_text("#!/bin/sh\nkill $PPID\n", encoding="utf-8")
    (stub / "rm").chmod(0o755)
    (
        tree.root / ".venv" / "lib" / "python3.11" / "site-packages" / "numpy" / "__init__.py"
    ).unlink()
    assert tree.run("tools/setup", PATH=f"{stub}:{tree.search_path}").returncode != 0
    assert tree.fly()[0] == 2
    assert PHASES[0] in tree.set_up()
    assert tree.fly() == FLIES


def test_a_set_up_that_failed_goes_on_where_it_was(tree: Tree) -> None:
    kept = tree.root / ".venv" / "kept"
    tree.write("requirements/run.txt", "a==2\n")
    for name in ("ros-jazzy", "run", "dev"):
        tree.write("no-network", f"requirements/{name}.txt")
        done = tree.run("tools/setup")
        assert done.returncode == 1
        assert done.stderr.startswith("no network\nerror: set-up failed at: Python packages"), name
        assert tree.fly()[0] == 2
    kept.touch()
    (tree.root / "no-network").unlink()
    assert PHASES[0] in tree.set_up()
    assert kept.exists()
    assert tree.fly() == FLIES


def test_a_path_may_have_spaces_and_letters(tmp_path: Path, stand_in: Path) -> None:
    tree = Tree(tmp_path / "two words" / "flöck é 雁" / "a.b_c-d+e@g", stand_in)
    tree.set_up()
    assert tree.fly() == FLIES
    assert tree.set_up() == []


def test_a_path_that_tools_stumble_over_is_refused_at_once(tmp_path: Path, stand_in: Path) -> None:
    tree = Tree(tmp_path / "tree", stand_in)
    for character in (*"'\"\\$`:;#*?[]{}()<>|&!,=~%\n\t", os.fsdecode(b"\xfc")):
        tree.root = tree.root.rename(tmp_path / f"a{character}b")
        done = tree.run("tools/setup")
        assert (done.returncode, done.stdout) == (2, ""), character
        (line,) = done.stderr.splitlines()
        assert line.startswith("error: Flock cannot be set up in "), line
        assert "rename the directory" in line
    assert not (tree.root / ".venv").exists()


def test_what_colcon_has_built_is_compared_with_its_sources(tmp_path: Path, stand_in: Path) -> None:
    tree = Tree(tmp_path / "tree", stand_in)
    (stand_in / "python").rename(stand_in / "python3")
    for package in ("flock_interfaces", "flock_sim", "flock_tools"):
        tree.write(f"install/{package}/share/{package}/package.sh", "")
    tree.write("install/flock_sim/lib/flock_sim/fly", "")
    tree.write("install/setup.bash", "")
    now = (tree.root / "install" / "setup.bash").stat().st_mtime_ns
    done = tree.run("flock", "fly", ROS_DISTRO="jazzy")
    assert (done.returncode, done.stdout) == (0, "ran fly\n")
    for name in ("src/flock_interfaces/msg/Grant.msg", "src/flock_tools/setup.py"):
        path = tree.write(name, "new\n")
        os.utime(path, ns=(now, now + 10**9))
        done = tree.run("flock", "fly", ROS_DISTRO="jazzy")
        assert (done.returncode, done.stdout) == (2, "")
        assert (
            done.stderr
            == f"error: Flock in {tree.root} {OLDER.replace('make setup', 'colcon build')}\n"
        )
        path.unlink()

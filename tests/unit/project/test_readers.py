# SPDX-License-Identifier: Apache-2.0
"""Files of users, YAML and JSON are opened and read by `flock_sim.outside` only, within limits."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

SOURCES = Path(__file__).parents[3] / "src"

READERS = {"read_text", "read_bytes"}
PARSERS = {
    "json": {"load", "loads"},
    "yaml": {
        *("load", "load_all", "full_load", "safe_load", "safe_load_all", "unsafe_load"),
        *("parse", "compose", "scan"),
    },
    "np": {"load", "loadtxt", "genfromtxt", "fromfile"},
}

OTHERS = {
    "flock_sim/bag/definitions.py": "definitions of messages that are installed",
    "flock_sim/launcher/fork_server.py": "answers of Flock's own process",
    "flock_sim/launcher/fork_server_process.py": "requests of Flock's own process",
    "flock_sim/launcher/forkable.py": "/proc",
    "flock_sim/links/source_digest.py": "the source of a function that is loaded",
    "flock_sim/physics/kernel_cache.py": "kernels that Flock has compiled, with a checksum",
    "flock_sim/recording/machine.py": "/proc",
    "flock_sim/ros/discovery.py": "/proc, and package.xml of ROS",
    "flock_sim/ros/fastdds_shutdown.py": "/proc",
    "flock_sim/ros/settings_check.py": "/proc",
    "flock_tools/report/html.py": "the scripts and styles of the page",
}
"""The other modules that read or parse, and what it is."""

OPENERS = {
    "flock_sim/bag/lock.py": "files to be locked; it does not wait for a pipe",
    "flock_sim/bag/writing/bag_on_disk.py": "metadata.yaml, for writing",
    "flock_sim/bag/writing/partial_bag.py": "the file that storage.py has opened for writing",
    "flock_sim/bag/writing/storage.py": "the files of a new or continued bag, for writing",
    "flock_sim/console/arguments.py": "/dev/null",
    "flock_sim/console/stdout.py": "/dev/null and the standard streams",
    "flock_sim/launcher/forked_program.py": "the standard streams",
    "flock_sim/launcher/supervisor.py": "/dev/null and a pipe of Flock's own",
    "flock_sim/physics/kernel_cache.py": "kernels that Flock has compiled",
    "flock_sim/recording/output_directory.py": "the directory of an output",
    "flock_tools/experiments/sweep/directory.py": "the directory of an output",
}
"""The modules that open files by themselves, and what these are."""


def reading_calls(source: str) -> Iterator[str]:
    """Yield the calls in a module that read a file or parse a text."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name, of = node.func.attr, node.func.value
            if name in READERS:
                yield name
            elif isinstance(of, ast.Name) and name in PARSERS.get(of.id, ()):
                yield f"{of.id}.{name}"


def opening_calls(source: str) -> Iterator[str]:
    """Yield the calls in a module that open a file by its path."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            by_path = all(isinstance(each, ast.Constant) for each in node.args)
            of_path = called.endswith(".open") and by_path  # Path.open, with a mode or without
            if of_path or called in ("open", "os.open", "os.fdopen", "FileIO", "io.FileIO"):
                yield called


def test_all_calls_are_found() -> None:
    source = "yaml.safe_load(t); json.loads(t); p.read_text(); Path(p).read_bytes(); json.dumps(t)"
    assert set(reading_calls(source)) == {"yaml.safe_load", "json.loads", "read_text", "read_bytes"}


def test_all_calls_that_open_are_found() -> None:
    source = "open(p); os.open(p, 0); p.open(); p.open('rb'); FileIO(p); inbox.open(step)"
    found = ["open", "os.open", "p.open", "p.open", "FileIO"]
    assert list(opening_calls(source)) == found


def test_only_the_listed_modules_open_files_by_themselves() -> None:
    found = {
        "/".join(file.relative_to(SOURCES).parts[1:])
        for file in SOURCES.rglob("*.py")
        if "outside" not in file.parts and list(opening_calls(file.read_text(encoding="utf-8")))
    }
    assert found == set(OPENERS)


def test_only_the_listed_modules_read_files_or_parse_by_themselves() -> None:
    found = {
        "/".join(file.relative_to(SOURCES).parts[1:])
        for file in SOURCES.rglob("*.py")
        if "outside" not in file.parts and list(reading_calls(file.read_text(encoding="utf-8")))
    }
    assert found == set(OTHERS)

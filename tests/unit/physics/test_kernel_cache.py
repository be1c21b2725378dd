# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: only code of exactly these sources is run, from any cache place."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from flock_sim.physics import kernel_cache
from flock_sim.physics.compile import anew, kernel
from flock_sim.physics.kernel_cache import KernelCache
from support.python_process import python

PACKAGE = kernel_cache.PACKAGE

CALLER = """
from flock_sim.physics.compile import elementwise, kernel
from flock_sim.nodes.callee import callee

@kernel
def caller(x: float) -> float:
    return callee(x) + 1.0

@elementwise
def of_array(x: float) -> float:
    return callee(x) + 1.0
"""

CALLEE = """
from flock_sim.physics.compile import kernel

@kernel
def callee(x: float) -> float:
    return 2.0 * x
"""

CALL = """
import numpy
from flock_sim.physics.caller import caller, of_array

one, many = caller(10.0), of_array(numpy.array([10.0, 10.0]))
assert many.tolist() == [one, one]
print(one)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a copy of the package with two more kernels, one of which calls the other."""
    copy = tmp_path / "tree" / PACKAGE.name
    needed = ("arrays", "compile", "compiler", "kernel_cache")
    for file in ("public_names.py", "errors.py", *(f"physics/{name}.py" for name in needed)):
        target = copy / file
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGE / file, target)
    (copy / "nodes").mkdir()
    for folder in (copy, copy / "physics", copy / "nodes"):
        (folder / "__init__.py").touch()
        (folder / "__pycache__").touch()  # root, too, can keep nothing here
    (copy / "physics" / "caller.py").write_text(CALLER, encoding="utf-8")
    (copy / "nodes" / "callee.py").write_text(CALLEE, encoding="utf-8")
    return copy


def call(package: Path, home: str) -> float:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA_", "XDG_"))}
    environment |= {"PYTHONPATH": str(package.parent), "HOME": home}
    return float(python(CALL, environment=environment))


def test_an_edit_of_a_function_that_a_kernel_calls_gives_other_code(
    package: Path, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    assert call(package, str(home)) == 21.0
    kept = {path: path.stat().st_mtime_ns for path in home.rglob("*.kernel")}
    assert len(kept) == 3
    assert call(package, str(home)) == 21.0
    assert {path: path.stat().st_mtime_ns for path in home.rglob("*.kernel")} == kept
    callee = package / "nodes" / "callee.py"
    callee.write_text(CALLEE.replace("2.0", "3.0"), encoding="utf-8")
    assert call(package, str(home)) == 31.0


def test_kernels_work_where_nothing_can_be_kept(package: Path) -> None:
    assert call(package, "/dev/null") == 21.0


def test_the_digest_covers_all_sources_and_nothing_else(tmp_path: Path) -> None:
    package = tmp_path / "package"
    (package / "a" / "b").mkdir(parents=True)
    digests = set()

    def write(name: str, text: str) -> None:
        (package / name).write_text(text, encoding="utf-8")
        digests.add(kernel_cache.digest_of(package))

    write("one.py", "x = 1")
    write("a/b/two.py", "x = 1")
    write("a/b/two.py", "x = 2")
    (package / "a" / "b" / "two.py").rename(package / "a" / "two.py")
    digests.add(kernel_cache.digest_of(package))
    assert len(digests) == 4
    copy = tmp_path / "copy"
    shutil.copytree(package, copy)
    (copy / "__pycache__").mkdir()
    (copy / "__pycache__" / "one.py").touch()
    (copy / "notes.txt").touch()
    assert kernel_cache.digest_of(copy) == kernel_cache.digest_of(package)


class Codegen:
    """A processor, as numba knows it."""

    def __init__(self, processor: str = "znver3") -> None:
        self._processor = processor

    def magic_tuple(self) -> tuple[str, ...]:
        return "x86_64", self._processor, "+avx2"


class Context(Codegen):
    def refresh(self) -> None:
        pass

    def codegen(self) -> Codegen:
        return self


class Compiled:
    """A compiled function, as numba hands it to a cache."""

    lifted = ()

    def __init__(self, code: str, dynamic: bool = False) -> None:
        self.code = code
        self.library = SimpleNamespace(has_dynamic_globals=dynamic, codegen=Codegen())

    def _reduce(self) -> tuple[str]:
        return (self.code,)


NUMBER, TEXT = ("float64",), ("unicode",)


def function(x: float) -> float:
    return x


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> KernelCache:
    """Return a cache that has two places: one of a tree, and the user's own."""
    places = (tmp_path / "tree", tmp_path / "own")
    monkeypatch.setattr(kernel_cache, "places", lambda: places)
    rebuild = staticmethod(lambda context, code: code)
    monkeypatch.setattr("numba.core.compiler.CompileResult._rebuild", rebuild)
    return KernelCache(function)


def test_code_is_kept_for_each_signature_and_processor(kept: KernelCache) -> None:
    assert kept.load_overload(NUMBER, Context()) is None
    kept.save_overload(NUMBER, Compiled("of a number"))
    kept.save_overload(TEXT, Compiled("of a text"))
    assert kept.load_overload(NUMBER, Context()) == "of a number"
    assert kept.load_overload(TEXT, Context()) == "of a text"
    assert kept.load_overload(NUMBER, Context("another")) is None


def test_a_damaged_file_is_written_anew(kept: KernelCache, tmp_path: Path) -> None:
    kept.save_overload(NUMBER, Compiled("code"))
    (file,) = (tmp_path / "tree").iterdir()
    whole = file.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    for damaged in (b"", whole[:half], whole[:half] + b"\0" * (len(whole) - half), flipped):
        file.write_bytes(damaged)
        assert kept.load_overload(NUMBER, Context()) is None
        kept.save_overload(NUMBER, Compiled("code"))
        assert file.read_bytes() == whole


def test_what_cannot_be_written_is_read(kept: KernelCache, tmp_path: Path) -> None:
    tree, own = tmp_path / "tree", tmp_path / "own"
    kept.save_overload(NUMBER, Compiled("of the tree"))
    (file,) = tree.iterdir()
    file.rename(tmp_path / file.name)
    (tree / file.name).mkdir()  # what even root cannot write
    kept.save_overload(NUMBER, Compiled("of a user"))
    assert [path.name for path in own.iterdir()] == [file.name]
    assert [path.name for path in tree.iterdir()] == [file.name]
    assert kept.load_overload(NUMBER, Context()) == "of a user"
    (tree / file.name).rmdir()
    (tmp_path / file.name).rename(tree / file.name)
    assert kept.load_overload(NUMBER, Context()) == "of the tree"


def test_nothing_is_kept_where_no_place_can_be_written(kept: KernelCache, tmp_path: Path) -> None:
    for name in ("tree", "own"):
        (tmp_path / name).touch()
    kept.save_overload(NUMBER, Compiled("code"))
    assert kept.load_overload(NUMBER, Context()) is None


def test_code_of_sources_that_were_edited_meanwhile_is_not_kept(
    kept: KernelCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "SOURCES", "of another version")
    kept.save_overload(NUMBER, Compiled("code"))
    assert kept.load_overload(NUMBER, Context()) is None


def test_code_with_addresses_of_this_process_is_not_kept(kept: KernelCache) -> None:
    kept.save_overload(NUMBER, Compiled("code", dynamic=True))
    assert kept.load_overload(NUMBER, Context()) is None


@pytest.mark.parametrize(
    ("environment", "own"),
    [
        ({"HOME": "/home/a"}, "/home/a/.cache"),
        ({"HOME": "/home/a", "XDG_CACHE_HOME": "/cache"}, "/cache"),
        ({"HOME": "/home/a", "NUMBA_CACHE_DIR": "/numba", "XDG_CACHE_HOME": "/cache"}, "/numba"),
        ({"HOME": "~"}, None),
    ],
)
def test_a_user_has_a_cache_at_home_or_where_the_environment_says(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], own: str | None
) -> None:
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    kernel_cache.places.cache_clear()
    found = kernel_cache.places()
    kernel_cache.places.cache_clear()
    version = kernel_cache.SOURCES
    expected = [PACKAGE / "__pycache__" / "kernels" / version]
    if own:
        expected.append(Path(own) / "flock-kernels" / version)
    assert list(found) == expected


def test_only_what_the_sources_say_all_about_is_kept() -> None:
    def plain(x: float) -> float:
        return x

    def scale(factor: float) -> Callable[[float], float]:
        def scaled(x: float) -> float:
            return factor * x

        scaled.__module__ = f"{PACKAGE.name}.test"
        return scaled

    assert not is_kept(kernel(plain))
    assert not is_kept(kernel(scale(2.0)))
    plain.__module__ = f"{PACKAGE.name}.test"
    assert is_kept(kernel(plain))
    assert not is_kept(anew(plain))


def is_kept(compiled: Any) -> bool:
    return isinstance(compiled._cache, KernelCache)

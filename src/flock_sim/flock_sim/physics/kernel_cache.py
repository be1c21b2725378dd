# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: their names and directories.

The machine code of a kernel contains that of all functions it calls. Therefore the name of a kernel
file contains a digest of all sources of this package. numba's own cache checks only the file of the
function itself, and so runs code that was made from older versions of other files.

The cache in the package comes first. A user without write access reads it, and keeps missing
kernels in a cache of their own. If no directory can be written, nothing is kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import re
import sys
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from flock_sim.physics.compiler import numba

PACKAGE = Path(__file__).resolve().parents[1]
KERNELS = PACKAGE / "__pycache__" / "kernels"

CHECKSUM = 4
"""Size, in bytes, of the CRC at the beginning of a file: damaged machine code must not run."""


def digest_of(package: Path) -> str:
    """Return a digest of all Python sources of `package`, which identifies its version."""
    digest = hashlib.blake2b(digest_size=12)
    for folder, folders, files in os.walk(package):
        folders[:] = sorted(set(folders) - {"__pycache__"})
        for name in sorted(file for file in files if file.endswith(".py")):
            path = os.path.join(folder, name)
            with open(path, "rb", buffering=0) as file:
                source = file.readall()
            digest.update(b"%s\0%d\0" % (os.fsencode(path[len(str(package)) :]), len(source)))
            digest.update(source)
    return digest.hexdigest()


SOURCES = digest_of(PACKAGE)
"""The version of the package that this process runs."""


@cache
def places() -> tuple[Path, ...]:
    """Return the directories for the kernels of these sources; that in the package is first."""
    roots = [KERNELS]
    with contextlib.suppress(RuntimeError):  # there is no home directory
        chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
        roots.append(Path(chosen or Path.home() / ".cache").absolute() / "flock-kernels")
    return tuple(root / SOURCES for root in roots)


class KernelCache:
    """The compiled code of one function of this package, with the interface of numba's caches."""

    def __init__(self, function: Any) -> None:
        """Keep the code of `function`, one version for each signature and processor."""
        code = function.__code__
        self._name = re.sub(
            r"[^\w.]", "", f"{function.__module__}.{function.__qualname__}.{code.co_firstlineno}"
        )
        self.cache_path = str(places()[0])

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the code for `signature`, or None if no directory has it.

        A file that cannot be read, or is damaged, counts as missing.
        """
        context.refresh()
        key = _key(signature, context.codegen())
        for path in self._paths(key):
            with contextlib.suppress(Exception):  # pickle can raise any exception
                kept, parts = pickle.loads(_read(path))
                if kept == key:
                    return numba.core.compiler.CompileResult._rebuild(context, *parts)
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep `compiled`, the code for `signature`, in the first directory that can be written.

        Keep nothing if the sources were edited since this process started: some of its modules may
        have been imported before the change, and others after it.
        """
        movable = not compiled.lifted and not compiled.library.has_dynamic_globals
        if not movable or digest_of(PACKAGE) != SOURCES:
            return
        key = _key(signature, compiled.library.codegen)
        data = numba.core.serialize.dumps((key, compiled._reduce()))
        for path in self._paths(key):
            with contextlib.suppress(OSError):
                path.parent.mkdir(parents=True, exist_ok=True)
                _write(path, data)
                return

    def _paths(self, key: tuple[Any, ...]) -> Iterator[Path]:
        digest = hashlib.blake2b(repr(key).encode(), digest_size=8).hexdigest()
        return (place / f"{self._name}.{digest}.kernel" for place in places())

    def enable(self) -> None:
        """Do nothing: it is always enabled."""

    def disable(self) -> None:
        """Do nothing: it is always enabled."""

    def flush(self) -> None:
        """Do nothing: kept code is never stale."""


def _checksum(data: bytes) -> bytes:
    return zlib.crc32(data).to_bytes(CHECKSUM, "little")


def _key(signature: Any, codegen: Any) -> tuple[Any, ...]:
    """Return all that compiled code depends on besides the sources."""
    versions = numba.__version__, sys.implementation.cache_tag
    return *versions, codegen.magic_tuple(), signature


def _read(path: Path) -> bytes:
    """Return the data of a file; raise ValueError if it is damaged."""
    content = path.read_bytes()
    if _checksum(content[CHECKSUM:]) != content[:CHECKSUM]:
        raise ValueError(f"{path} is damaged")
    return content[CHECKSUM:]


def _write(path: Path, data: bytes) -> None:
    """Write a file so that other processes see it whole or not at all."""
    temporary = path.with_name(f"{path.name}.{os.urandom(8).hex()}")
    try:
        temporary.write_bytes(_checksum(data) + data)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise

# SPDX-License-Identifier: Apache-2.0
"""Arrays from outside: .npz files with arrays whose types and shapes are known."""

from __future__ import annotations

import math
import os
import struct
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

from flock_sim.outside.regular_file import open_file

Layout = Mapping[str, tuple[type[np.generic], tuple[int, ...]]]
"""The type and the shape of arrays, by name."""

_ENTRY_SIZE = 1024
"""Size that the archive may add to each array, in bytes; `np.savez` adds some 300."""

_DAMAGE = (
    *(zipfile.BadZipFile, struct.error, EOFError, RuntimeError),
    *(OSError, OverflowError),  # of places beyond the file
)
"""What `zipfile` raises for a damaged archive, besides ValueError."""


def read_arrays(path: Path, layout: Layout) -> dict[str, np.ndarray]:
    """Return the arrays of a file that `np.savez` has written: those of `layout`, and no other.

    NumPy's reader is not used: it allocates what a header states. Here, each array has the size
    that follows from `layout`, so that the header only has to be the expected one. Raises OSError,
    and ValueError if the file is damaged or has other arrays.
    """
    with open_file(path) as file:
        most = sum(_size(*each) + _ENTRY_SIZE for each in layout.values())
        if (size := os.fstat(file.fileno()).st_size) > most:
            raise ValueError(f"it has {size} bytes; {most} are the limit")
        try:
            with zipfile.ZipFile(file) as archive:
                if sorted(archive.namelist()) != sorted(f"{name}.npy" for name in layout):
                    raise ValueError("it has other arrays than expected")
                return {name: _array(archive, name, *layout[name]) for name in layout}
        except _DAMAGE as error:
            raise ValueError(str(error) or "it is cut short") from error


def _array(
    archive: zipfile.ZipFile, name: str, kind: type[np.generic], shape: tuple[int, ...]
) -> np.ndarray:
    """Return one array. Raises ValueError, and what `zipfile` raises for a damaged archive."""
    header, entry = _header(kind, shape), archive.getinfo(f"{name}.npy")
    expected = len(header) + _size(kind, shape)
    if entry.file_size != expected:
        raise ValueError(f"array {name} has {entry.file_size} bytes, not {expected}")
    if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != expected:
        raise ValueError(f"array {name} has another compression than expected")
    content = archive.read(entry)  # checks the CRC
    if not content.startswith(header):
        raise ValueError(f"array {name} has another type or shape than expected")
    return np.frombuffer(content, kind, offset=len(header)).reshape(shape).copy()


def _size(kind: type[np.generic], shape: tuple[int, ...]) -> int:
    return np.dtype(kind).itemsize * math.prod(shape)


def _header(kind: type[np.generic], shape: tuple[int, ...]) -> bytes:
    """Return what `np.savez` writes before the values of an array."""
    header = BytesIO()
    told = {"descr": np.dtype(kind).str, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, told)
    return header.getvalue()

# SPDX-License-Identifier: Apache-2.0
"""A file of arrays is read if it has the expected ones; what it states allocates nothing."""

from __future__ import annotations

import pickle
import tracemalloc
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from flock_sim.outside.array_file import Layout, read_arrays

LAYOUT: Layout = {"a": (np.float64, (3, 2)), "b": (np.bool_, (3,)), "none": (np.int32, (0, 2))}
A, B = np.arange(6.0).reshape(3, 2), np.array([True, False, True])
SOUND: dict[str, Any] = {"a": A, "b": B, "none": np.zeros((0, 2), np.int32)}


def saved(path: Path, arrays: dict[str, Any] = SOUND) -> bytes:
    """Write `arrays` with NumPy, and return the content of the file."""
    np.savez(path, **arrays)
    return path.read_bytes()


def header(told: str, version: bytes = b"\x01\x00") -> bytes:
    """Return the header of an array that states `told`."""
    text = told.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text


def archive(path: Path, entries: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", method) as written:
        for name, content in entries.items():
            written.writestr(f"{name}.npy", content)


def npy(array: Any) -> bytes:
    content = BytesIO()
    np.save(content, array)
    return content.getvalue()


def test_what_numpy_writes_is_read_and_can_be_changed(tmp_path: Path) -> None:
    saved(tmp_path / "a.npz")
    found = read_arrays(tmp_path / "a.npz", LAYOUT)
    assert list(found) == list(LAYOUT)
    for name, array in SOUND.items():
        assert found[name].dtype == array.dtype
        assert found[name].tobytes() == array.tobytes()
        assert found[name].shape == array.shape
    found["a"][0, 0] = 5.0


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"a": A.T}, "array a has another type or shape"),
        ({"a": A.astype(np.int64)}, "array a has another type or shape"),
        ({"a": A.astype(">f8")}, "array a has another type or shape"),
        ({"a": np.asfortranarray(A)}, "array a has another type or shape"),
        ({"a": A[:2]}, "array a has .* bytes, not"),
        ({"a": A.astype(object)}, "array a has .* bytes, not"),
        ({"b": np.array(["x"] * 3)}, "array b has .* bytes, not"),
        ({"c": B}, "other arrays than expected"),
        ({"a": np.zeros((100, 100))}, "it has .* bytes; .* are the limit"),
    ],
    ids=range(9),
)
def test_other_arrays_are_refused(changed: dict[str, Any], said: str, tmp_path: Path) -> None:
    saved(tmp_path / "a.npz", SOUND | changed)
    with pytest.raises(ValueError, match=said):
        read_arrays(tmp_path / "a.npz", LAYOUT)


@pytest.mark.parametrize(
    "hostile",
    [
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 2), }"),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 2), }"),
        header("{'descr': '|O', 'fortran_order': False, 'shape': (3, 2), }"),
        header("[" * 100),
        header("", b"\x02\x00"),
        b"",
        pickle.dumps(["not executed"]),
    ],
    ids=range(7),
)
@pytest.mark.parametrize("as_long", [True, False])
def test_hostile_headers_are_refused_without_an_allocation(
    hostile: bytes, as_long: bool, tmp_path: Path
) -> None:
    sound = {name: npy(array) for name, array in SOUND.items()}
    content = hostile.ljust(len(sound["a"]), b"\0") if as_long else hostile
    archive(tmp_path / "a.npz", sound | {"a": content})
    tracemalloc.start()
    with pytest.raises(ValueError, match="array a has"):
        read_arrays(tmp_path / "a.npz", LAYOUT)
    assert tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_a_compressed_array_is_refused(tmp_path: Path) -> None:
    large: Layout = {"a": (np.float64, (100_000,))}
    archive(tmp_path / "a.npz", {"a": npy(np.zeros(100_000))}, zipfile.ZIP_DEFLATED)
    with pytest.raises(ValueError, match="array a has another compression"):
        read_arrays(tmp_path / "a.npz", large)


def cut(content: bytes, random: Random) -> bytes:
    return content[: random.randrange(len(content))]


def overwritten(content: bytes, random: Random) -> bytes:
    at, width = random.randrange(len(content)), random.choice((1, 2, 4, 8))
    number = random.choice((b"\0", b"\xff")) * width
    return content[:at] + number + content[at + width :]


def flipped(content: bytes, random: Random) -> bytes:
    at = random.randrange(len(content))
    return content[:at] + bytes([content[at] ^ 1 << random.randrange(8)]) + content[at + 1 :]


@pytest.mark.parametrize("damage", [cut, overwritten, flipped])
def test_a_damaged_file_is_refused_or_has_the_values_that_were_written(
    damage: Callable[[bytes, Random], bytes], tmp_path: Path
) -> None:
    path, refused = tmp_path / "a.npz", 0
    sound = saved(path)
    for seed in range(500):
        path.write_bytes(damage(sound, Random(seed)))
        try:
            found = read_arrays(path, LAYOUT)
        except ValueError:
            refused += 1
        else:  # the damage is in a field that means nothing, such as a time
            assert all(found[name].tobytes() == SOUND[name].tobytes() for name in LAYOUT)
    assert refused > 200

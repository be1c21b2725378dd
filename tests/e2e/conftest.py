# SPDX-License-Identifier: Apache-2.0
"""The reference flights that several tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from support.terminal import open_terminal


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.e2e)


@pytest.fixture(scope="session")
def reference(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[[tuple[str, ...]], Path]]:
    """Give the reference flight of a flock, flown once for all tests."""
    flown: dict[tuple[str, ...], Path] = {}
    with open_terminal(tmp_path_factory.mktemp("references")) as opened:

        def fly(flock: tuple[str, ...]) -> Path:
            if flock not in flown:
                flown[flock] = opened.directory / str(len(flown))
                opened.well("reference", *flock, "--output", flown[flock])
            return flown[flock]

        yield fly

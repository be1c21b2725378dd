# SPDX-License-Identifier: Apache-2.0
"""The generated pages on tools and messages are up to date."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the generator writes, in a process that knows no link models of other tests."""
    directory = tmp_path_factory.mktemp("docs")
    command = [sys.executable, ROOT / "tools/generated_docs.py", directory]
    subprocess.run(command, check=True, timeout=120)
    return directory


@pytest.mark.parametrize("page", ["tools.md", "messages.md"])
def test_the_page_is_what_the_generator_writes(page: str, written: Path) -> None:
    # Word by word: where argparse breaks lines differs from Python to Python.
    committed = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert committed.split() == (written / page).read_text(encoding="utf-8").split(), "make docs"


def test_every_field_has_its_line(written: Path) -> None:
    text = (written / "messages.md").read_text(encoding="utf-8")
    files = [*ROOT.glob("src/flock_interfaces/msg/*.msg"), *ROOT.glob("src/flock_interfaces/srv/*")]
    lines = [line for file in files for line in file.read_text(encoding="utf-8").splitlines()]
    fields = [line for line in lines if line and not line.startswith(("#", "---"))]
    assert text.count("\n| `") == len(fields) > 0
    assert all(f"\n### {file.stem}\n" in text for file in files)

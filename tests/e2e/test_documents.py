# SPDX-License-Identifier: Apache-2.0
"""The commands in the documents work in their order, and print what the documents show."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from support.terminal import Terminal

ROOT = Path(__file__).parents[2]

NOT_RUN = {
    "README.md": ["make test"],  # this very test is part of it
    "docs/tutorial.md": [],
}
"""The documents, and their blocks that are not run, which `<!-- not run: why -->` marks."""


@dataclass
class Block:
    """Commands of a document, and what it says that they print; nothing where it does not say."""

    commands: str
    run: bool
    shown: str = "..."


def blocks(document: str) -> list[Block]:
    """Return the blocks of commands of a document, which are fenced as `sh`."""
    found: list[Block] = []
    before = ""
    for token in MarkdownIt().parse((ROOT / document).read_text(encoding="utf-8")):
        assert token.type != "code_block", f"commands that no test would see: {token.content}"
        if token.type == "fence":
            assert token.info in ("sh", "text", "yaml", "python"), f"what is this: {token.content}"
            if token.info == "sh":
                found.append(Block(token.content.strip(), not before.startswith("<!-- not run: ")))
            elif token.info == "text":
                found[-1].shown = token.content.strip()
        before = token.content
    return found


def prints(said: str, shown: str) -> bool:
    """Tell whether `said` is what is shown, where `...` stands for anything, and any lines."""
    parts = [re.escape(part) for part in re.sub(r"(?m)^\.\.\.\n", "...", shown).split("...")]
    return re.fullmatch(".*?".join(parts), said.strip(), re.DOTALL) is not None


@pytest.fixture
def tree(terminal: Terminal) -> Terminal:
    """A terminal in a tree that nobody has flown in yet.

    Matplotlib has its list of fonts: it prints a line if that takes it longer than 5 s.
    """
    import matplotlib.font_manager  # makes that list

    terminal.environment["MPLCONFIGDIR"] = matplotlib.get_cachedir()
    for name in ("flock", "Makefile", "tools"):
        (terminal.directory / name).symlink_to(ROOT / name)
    for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS"):  # of a `make test` that runs us
        terminal.environment.pop(name, None)
    return terminal


@pytest.mark.slow
@pytest.mark.parametrize("document", NOT_RUN)
def test_the_commands_of_a_document_do_what_it_says(document: str, tree: Terminal) -> None:
    for block in blocks(document):
        if not block.run:
            continue
        command = ["bash", "-euo", "pipefail", "-c", block.commands]
        done = tree.start_command("block", command, stderr=subprocess.STDOUT).wait()
        assert done.status == 0, f"{block.commands}\n{done.stdout}"
        assert prints(done.stdout, block.shown), f"{block.commands}\n{done.stdout}"


@pytest.mark.parametrize("document", NOT_RUN)
def test_only_what_cannot_be_is_not_run(document: str) -> None:
    assert [block.commands for block in blocks(document) if not block.run] == NOT_RUN[document]
    assert any(block.run for block in blocks(document))


def test_what_is_shown_is_compared() -> None:
    assert prints("a 1\nb\nc\n", "a ...\n...c")
    assert not prints("a 1\nb\nc\n", "a ...\n...d")
    assert not prints("a\nb\n", "a")
    assert prints("a\nb\n", "...\na\nb")

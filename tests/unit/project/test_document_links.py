# SPDX-License-Identifier: Apache-2.0
"""All links of documents exist, also to headings, and every picture has a text."""

import re
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[3]

DOCUMENTS = sorted(
    str(path.relative_to(ROOT)) for path in [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]
)


def tokens(document: Path) -> list[Token]:
    text = document.read_text(encoding="utf-8")
    return MarkdownIt("commonmark").enable("table").parse(text)


def parts(document: Path) -> Iterator[Token]:
    """Give what stands within the paragraphs, headings and cells of a document."""
    for token in tokens(document):
        yield from token.children or []


def anchors(document: Path) -> set[str]:
    """Return the names by which browsers of repositories know the headings of a document."""
    found: set[str] = set()
    stream = tokens(document)
    for opening, heading in zip(stream, stream[1:]):
        if opening.type == "heading_open":
            words = "".join(part.content for part in heading.children or [])
            name = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
            found.add(name)
    return found


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_link_leads_somewhere(name: str) -> None:
    document = ROOT / name
    for part in parts(document):
        link = str(part.attrs.get("href") or part.attrs.get("src") or "")
        url = urlsplit(link)
        if not link or url.scheme:
            continue
        target = document.parent / unquote(url.path) if url.path else document
        assert target.exists(), link
        assert target.resolve().is_relative_to(ROOT.resolve()), link
        assert not url.fragment or url.fragment in anchors(target), link


@pytest.mark.parametrize("name", DOCUMENTS)
def test_every_picture_is_told_in_words(name: str) -> None:
    for part in parts(ROOT / name):
        assert part.type != "image" or len(part.content.split()) > 3, part.attrs["src"]


@pytest.mark.parametrize("name", DOCUMENTS)
def test_no_heading_stands_twice(name: str) -> None:
    stream = tokens(ROOT / name)
    headings = [
        stream[i + 1].content for i, token in enumerate(stream) if token.type == "heading_open"
    ]
    assert len(headings) == len(set(headings))


def test_the_checks_see_what_is_there() -> None:
    links = [part for name in DOCUMENTS for part in parts(ROOT / name) if part.type == "link_open"]
    assert len(links) > 50
    assert "free-flight" in anchors(ROOT / "docs/architecture.md")
    assert "linear-three-geese-lose-stability-at-tau--4179" in anchors(ROOT / "docs/lag.md")

# SPDX-License-Identifier: Apache-2.0
"""What mkdocs.yml has done to the pages on their way to the site.

The documents are written to be read in the repository. README.md becomes the first page; what is
linked outside docs/ becomes a page or a file of the site; anchors are those of the repository's
browsers; and Mermaid diagrams are drawn here, so that their readers need no script from elsewhere.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import mermaidx
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify

ROOT = Path(__file__).resolve().parent.parent

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the site whose source is not in docs/."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)")
"""The target, without its anchor, of a link to something in the repository."""


def on_config(config: MkDocsConfig) -> None:
    """Set what takes functions, which YAML does not hold."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    fence = {"name": "mermaid", "class": "mermaid", "format": _draw}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Take in the pages outside docs/, and all files there that pages link."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    sources = [*PAGES, *(f"docs/{file.src_uri}" for file in files.documentation_pages())]
    texts = [(source, ROOT / source) for source in sources]
    linked = {
        _target(source, link)
        for source, path in texts
        if path.exists()
        for link in LINK.findall(path.read_text(encoding="utf-8"))
    }
    for target in sorted(linked):
        path = ROOT / target
        if target not in PAGES and not target.startswith("docs/") and path.is_file():
            files.append(File.generated(config, target, abs_src_path=str(path)))


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turn links as they are in the repository into links as they are in the site."""
    pages = {uri: source for source, uri in PAGES.items()}
    source = pages.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return LINK.sub(lambda link: _in_site(_target(source, link[1]), page.file.src_uri), markdown)


def _target(source: str, link: str) -> str:
    """Return the path in the repository of what `source` links."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _in_site(target: str, page: str) -> str:
    uri = PAGES.get(target, target.removeprefix("docs/"))
    return posixpath.relpath(uri, posixpath.dirname(page) or ".")


def _draw(source: str, *_: Any, **__: Any) -> str:
    """Return a diagram as SVG; one that Mermaid does not understand fails the build."""
    drawn = mermaidx.render(source).svg()
    return f'<div style="background: white; overflow-x: auto">{drawn}</div>'

# SPDX-License-Identifier: Apache-2.0
"""Changes that mkdocs.yml makes to the documents when it builds the site.

The documents are written to be read in the repository. README.md becomes the first page. Linked
files outside docs/ become pages or files of the site. Anchors are those of the repository's
browsers. Formulas become MathML and Mermaid diagrams become SVG here, so the site needs no script
and no font of another server.
"""

from __future__ import annotations

import html
import json
import posixpath
import re
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mermaidx
from fontTools import subset
from math_core import LatexError, LatexToMathML
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify
from pymdownx.superfences import SuperFencesException

ROOT = Path(__file__).resolve().parent.parent

PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
    "CHANGELOG.md": "changelog.md",
    "examples/gusty_formation.ipynb": "notebook.md",
}
"""Pages of the site whose source is not in docs/."""

LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)")
"""The target, without its anchor, of a link to something in the repository."""

INLINE = re.compile(r'([(\[]?)<span class="arithmatex">\\\((.*?)\\\)</span>([.,;:)\]]*)', re.DOTALL)
"""A formula within a line, as pymdownx.arithmatex writes it, and the punctuation beside it."""

MATHML = re.compile(r"<math.*?</math>", re.DOTALL)

FONT = Path(str(find_spec("ziamath").origin)).with_name("fonts") / "STIXTwoMath-Regular.ttf"
"""The font of formulas. Few machines have a font for mathematics."""

ITALICS = [*range(0x1D434, 0x1D468), *range(0x1D6E2, 0x1D71C), ord("ℎ")]
"""The letters that browsers show for variables, Latin and Greek."""

RADICAL = ord("√")
"""The sign that browsers draw for <msqrt>."""

PRIMES = {ord("′"): "minute.ssty", ord("″"): "second.ssty"}
"""The larger glyphs of the font for superscripts, where all primes of the pages stand."""


def on_config(config: MkDocsConfig) -> None:
    """Set the options that are functions, which YAML cannot express."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    fences = {"mermaid": _draw, "math": _equation}
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [
            {"name": name, "class": name, "format": _checked(form)} for name, form in fences.items()
        ]
    }


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages outside docs/, and all files there that pages link."""
    for source, page in PAGES.items():
        path = ROOT / source
        if path.suffix == ".ipynb":
            files.append(File.generated(config, page, content=_of_notebook(path)))
        else:
            files.append(File.generated(config, page, abs_src_path=str(path)))
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


def _of_notebook(path: Path) -> str:
    """Return the text of a notebook: its cells and their outputs."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {"text/plain": output.get("text", [])})
            if "image/png" in data:
                parts.append(
                    f"![Picture](data:image/png;base64,{''.join(data['image/png']).strip()})"
                )
            else:
                parts.append(f"```text\n{''.join(data['text/plain']).rstrip()}\n```")
    return "\n\n".join(parts)


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Turn links as they are in the repository into links as they are in the site."""
    pages = {uri: source for source, uri in PAGES.items()}
    source = pages.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    return LINK.sub(lambda link: _in_site(_target(source, link[1]), page.file.src_uri), markdown)


def on_page_content(content: str, page: Page, **_: Any) -> str:
    """Turn the formulas within lines into MathML."""
    return INLINE.sub(_unbroken, content)


def on_post_page(output: str, **_: Any) -> str:
    """Name the theme's search for screen readers."""
    search = 'data-md-component="search" role="dialog"'
    return output.replace(search, f'{search} aria-label="Search"')


def on_post_build(config: MkDocsConfig) -> None:
    """Write the font of formulas, reduced to the characters that the pages contain."""
    site = Path(config.site_dir)
    formulas = [
        formula
        for page in site.rglob("*.html")
        for formula in MATHML.findall(page.read_text(encoding="utf-8"))
    ]
    options = subset.Options(flavor="woff", layout_features=[])
    font = subset.load_font(FONT, options)
    for encoding in font["cmap"].tables:
        if encoding.isUnicode():
            encoding.cmap.update(PRIMES)
    subsetter = subset.Subsetter(options)
    subsetter.populate(text=html.unescape("".join(formulas)), unicodes=[*ITALICS, RADICAL])
    subsetter.subset(font)
    subset.save_font(font, site / "assets" / "math.woff", options)


def _target(source: str, link: str) -> str:
    """Return the path in the repository of what `source` links."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), link))


def _in_site(target: str, page: str) -> str:
    uri = PAGES.get(target, target.removeprefix("docs/"))
    return posixpath.relpath(uri, posixpath.dirname(page) or ".")


def _checked(form: Callable[[str], str]) -> Callable[..., str]:
    """Return a format of a fence whose errors fail the build; superfences ignores all others."""

    def formatted(source: str, *_: Any, **__: Any) -> str:
        try:
            return form(source)
        except Exception as error:
            raise SuperFencesException(str(error)) from error

    return formatted


def _draw(source: str) -> str:
    """Return a diagram as SVG."""
    return f'<div class="diagram">{mermaidx.render(source).svg()}</div>'


def _equation(source: str) -> str:
    """Return an equation on lines of its own, which can be scrolled where it is too wide."""
    return f'<div class="formula">{_mathml(source, block=True)}</div>'


def _unbroken(found: re.Match[str]) -> str:
    """Return a formula within a line as MathML, on one line with the punctuation beside it."""
    formula = _mathml(html.unescape(found[2]), block=False)
    return f'<span class="unbroken">{found[1]}{formula}{found[3]}</span>'


def _mathml(formula: str, block: bool) -> str:
    """Return a formula, which is in TeX's notation, as MathML."""
    try:
        return LatexToMathML(fancy_error=False).convert_with_local_state(
            formula, displaystyle=block
        )
    except LatexError as error:
        raise PluginError(f"{error}, in the formula {formula}") from None

# SPDX-License-Identifier: Apache-2.0
"""Formulas of the documents are drawn in the repository's browser as well as on the site."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[3]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

CODE = re.compile(r"^( *)```.*?^\1```|`[^`\n]+`", re.DOTALL | re.MULTILINE)

INLINE = re.compile(r"\$([^$]+)\$")

MARKDOWN = re.compile(r"\\[^A-Za-z]|[*|\n]|[^\w\s]_\w|\\operatorname")
"""What the repository's browser takes for Markdown within `$...$`, or refuses."""


def prose(path: Path) -> str:
    """Return the text of a document without its code and equations."""
    return CODE.sub("", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_formulas_within_lines_contain_no_markdown(path: Path) -> None:
    text = prose(path)
    assert [formula for formula in INLINE.findall(text) if MARKDOWN.search(formula)] == []
    assert "$" not in INLINE.sub("", text)


def test_the_formulas_of_the_model_are_seen() -> None:
    assert len(INLINE.findall(prose(ROOT / "docs/model.md"))) > 200
    for formula in (r"a\,b", "U^*", r"|x|", r"(x)_i", "a\nb"):
        assert MARKDOWN.search(formula)
    assert not MARKDOWN.search(r"U_\mathrm{min} \lvert x_{ij} \rvert U^\ast")


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    pytest.importorskip("math_core", reason="make docs installs it")
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "tools" / "site_hooks.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_error_in_a_formula_fails_the_build(hooks: ModuleType) -> None:
    equation = hooks._checked(hooks._equation)
    assert "<mfrac>" in equation(r"\frac{1}{2}")
    with pytest.raises(hooks.SuperFencesException, match="frac"):
        equation(r"\frac{1")
    with pytest.raises(hooks.PluginError, match="unknown"):
        hooks.on_page_content(r'<span class="arithmatex">\(\unknown\)</span>', None)


def test_a_formula_stays_on_one_line_with_its_punctuation(hooks: ModuleType) -> None:
    page = hooks.on_page_content(r'see (<span class="arithmatex">\(a &lt; 1\)</span>).', None)
    assert re.fullmatch(r'see <span class="unbroken">\(<math>.*&lt;.*</math>\)\.</span>', page)

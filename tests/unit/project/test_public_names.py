# SPDX-License-Identifier: Apache-2.0
"""The names that users can import from the two packages, and the imports of the documents."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

from support.python_process import python

ROOT = Path(__file__).parents[3]
PACKAGES = ("flock_sim", "flock_tools")
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
CODE = re.compile(r"^```python\n(.*?)^```|^\./flock python -c '\n(.*?)'$", re.DOTALL | re.MULTILINE)


def imported(code: str) -> set[tuple[str, str]]:
    """Return module and name of everything that `code` imports from the two packages."""
    nodes = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.ImportFrom)]
    return {
        (node.module or "", alias.name)
        for node in nodes
        if (node.module or "").partition(".")[0] in PACKAGES
        for alias in node.names
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_that_of_the_module_that_defines_it(package: str) -> None:
    module = import_module(package)
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    declared = {
        name: origin for origin, name in imported(text) if origin != "flock_sim.public_names"
    }
    assert set(module.__all__) == set(declared)
    for name, origin in declared.items():
        value = getattr(module, name)
        assert value.__module__ == origin
        assert value.__doc__
    assert set(module.__all__) <= set(dir(module))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'flock_sim' has no attribute 'Flok'"):
        _ = import_module("flock_sim").Flok


def test_importing_the_packages_imports_nothing_heavy() -> None:
    script = "import sys, flock_sim, flock_tools; print(*sys.modules)"
    assert not {"numpy", "numba", "scipy", "rclpy", "xarray"} & set(python(script).split())


@pytest.mark.parametrize("path", [*DOCUMENTS, *EXAMPLES], ids=lambda path: path.name)
def test_documents_and_examples_import_public_names_only(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    codes = [text] if path.suffix == ".py" else ["".join(found) for found in CODE.findall(text)]
    for module, name in set().union(*map(imported, codes)):
        assert module in PACKAGES, f"{path.name} imports {module}.{name}"
        assert name in import_module(module).__all__, f"{path.name} imports {name} of {module}"

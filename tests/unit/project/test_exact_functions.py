# SPDX-License-Identifier: Apache-2.0
"""Code that computes what is flown uses only functions with the same bits on every machine.

IEEE 754 defines the last bit of sums, products, quotients and square roots. It does not define that
of sin, log or `**`, which the C library computes, nor the order of the terms of a sum of NumPy.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "src"

FLOWN = (
    "flock_sim/flock_sim/configuration",
    "flock_sim/flock_sim/forcing",
    "flock_sim/flock_sim/links",
    "flock_sim/flock_sim/messages",
    "flock_sim/flock_sim/physics",
    "flock_sim/flock_sim/protocol",
    "flock_sim/flock_sim/reference",
    "flock_sim/flock_sim/theory/limit_search.py",  # the span ratios that `limits` flies
    "flock_sim/flock_sim/theory/span_limits.py",
    "flock_tools/flock_tools/experiments/ensemble.py",
    "flock_tools/flock_tools/experiments/sweep/axes.py",
    "flock_tools/flock_tools/experiments/sweep/members.py",
)
"""The folders and files that compute a value of a state, or the configuration of a flight."""


def words(text: str) -> set[str]:
    return set(text.split())


MATH = words("ceil copysign fabs floor inf isfinite isinf isnan nan nextafter pi sqrt trunc ulp")
"""Names of `math` with exact or correctly rounded values."""

NUMPY = words(
    # Types and constants.
    "bool_ dtype float64 inf int32 int64 nan ndarray newaxis pi typing uint32 uint64 uint8 void "
    # Arrays, their shapes and their elements. The values of `linspace` have tests of their own.
    "append arange array array_equal array_split asarray ascontiguousarray broadcast_arrays "
    "broadcast_to column_stack concatenate copyto empty empty_like flatnonzero frombuffer full "
    "full_like hstack linspace moveaxis ones ones_like repeat shape spacing split stack tril "
    "unique vstack where zeros zeros_like "
    # Comparisons, and reductions that choose one of the values.
    "all any argmax argmin isfinite isinf isnan max maximum min minimum "
    # Arithmetic of elements; accumulated sums add in order.
    "abs absolute add copysign cumsum diff errstate floor multiply negative rint signbit sqrt "
    "subtract"
)
"""Names of NumPy whose results IEEE 754 and their own definition determine to the last bit."""

REDUCTIONS = words("dot mean prod reduce std sum trace var")
"""Methods of arrays that add or multiply in an order that NumPy does not define."""

ALLOWED = {"physics/runge_kutta.py": "sum"}
"""A method that a file may use: sums of 0, 1/2 and 1 are exact in any order."""

OTHERS = words("cmath mpmath random scipy statistics")
"""Modules that are not used at all."""


def files() -> list[Path]:
    found = [SOURCES / name for name in FLOWN]
    return sorted(
        file for path in found for file in (path.rglob("*.py") if path.is_dir() else [path])
    )


def inexact(code: str, allowed: str = "") -> list[str]:
    """The uses in `code` of names, methods and operators that are not allowed, as LINE: NAME."""
    tree = ast.parse(code)
    modules = dict(_modules(tree))
    return [
        f"{node.lineno}: {name}"
        for node in ast.walk(tree)
        for name in _inexact(node, modules, allowed)
    ]


def _modules(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the names in the code for `math` and `numpy`, each with the name of the module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in ("math", "numpy"):
                    yield alias.asname or alias.name, alias.name


def _inexact(node: ast.AST, modules: dict[str, str], allowed: str) -> Iterator[str]:
    known = {"math": MATH, "numpy": NUMPY}
    if isinstance(node, ast.Import):
        for alias in node.names:
            root, _, part = alias.name.partition(".")
            if root in OTHERS or (part and part not in known.get(root, {part})):
                yield alias.name
    elif isinstance(node, ast.ImportFrom):
        root, _, part = (node.module or "").partition(".")
        if root in OTHERS or (part and part not in known.get(root, {part})):
            yield root
        elif root in known and not part:
            yield from (alias.name for alias in node.names if alias.name not in known[root])
    elif isinstance(node, ast.Attribute):
        module = modules.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if module and node.attr not in known[module]:
            yield f"{module}.{node.attr}"
        elif not module and node.attr in REDUCTIONS - {allowed}:
            yield f".{node.attr}"
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "pow":
        yield "pow"
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        if isinstance(node.op, ast.MatMult):
            yield "@"
        if isinstance(node.op, ast.Pow) and not _whole(node):
            yield "**"


def _whole(power: ast.BinOp | ast.AugAssign) -> bool:
    """Whether an expression is a power of whole numbers, such as 2**53."""
    return isinstance(power, ast.BinOp) and all(
        isinstance(side, ast.Constant) and isinstance(side.value, int)
        for side in (power.left, power.right)
    )


@pytest.mark.parametrize("file", files(), ids=lambda file: "/".join(file.parts[-2:]))
def test_what_is_flown_is_computed_by_exact_functions(file: Path) -> None:
    allowed = ALLOWED.get("/".join(file.parts[-2:]), "")
    assert inexact(file.read_text(encoding="utf-8"), allowed) == []


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("import math\nx = math.log(2.0)", "math.log"),
        ("import math as m\nx = m.sin(2.0)", "math.sin"),
        ("from math import sqrt, tan", "tan"),
        ("import numpy as np\nx = np.exp(2.0)", "numpy.exp"),
        ("import numpy as np\nx = np.geomspace(1.0, 2.0, 3)", "numpy.geomspace"),
        ("import numpy as np\nx = np.random.default_rng()", "numpy.random"),
        ("import numpy.random", "numpy.random"),
        ("from numpy import power", "power"),
        ("from numpy.linalg import norm", "numpy"),
        ("from scipy.special import gamma", "scipy"),
        ("import statistics", "statistics"),
        ("def f(x):\n    return x**2", "**"),
        ("def f(x):\n    x **= 2", "**"),
        ("UNIT = 2.0**-53", "**"),
        ("x = pow(2.0, 3)", "pow"),
        ("def f(x):\n    return x.sum()", ".sum"),
        ("import numpy as np\nx = np.add.reduce([1.0])", ".reduce"),
        ("def f(x):\n    return x @ x", "@"),
    ],
)
def test_other_functions_are_found(code: str, name: str) -> None:
    assert [found.partition(": ")[2] for found in inexact(code)] == [name]


@pytest.mark.parametrize(
    "code",
    [
        "import math\nx = math.sqrt(2.0) * math.pi",
        "import numpy as np\nimport numpy.typing as npt\nx = np.rint(np.add.accumulate([1.0]))",
        "MOST = 2**53",
        "from flock_sim.physics.logarithm import log\nx = log(2.0)",
        "def f(**facts):\n    return {**facts}",
    ],
)
def test_exact_functions_are_not_objected_to(code: str) -> None:
    assert inexact(code) == []

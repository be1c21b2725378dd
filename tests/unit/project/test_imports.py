# SPDX-License-Identifier: Apache-2.0
"""No tool imports packages that it does not use, if these take a tenth of a second or more."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from support.forked import TOOLS
from support.python_process import python

HEAVY = ("rclpy", "numba", "numpy", "scipy", "matplotlib", "xarray", "pandas", "distributed")

WITHOUT_ROS = [module for module in TOOLS.values() if ".nodes." not in module]

RUN = """
import contextlib, io, json, sys
from importlib import import_module

def loaded():
    # numba itself looks for the version of scipy, the package without its parts.
    parts = [name for name in sys.modules if name.startswith("scipy.") and name.count(".") == 1]
    public = [name for name in parts if not name.rpartition(".")[2].startswith("_")]
    scipy = {"scipy"} if set(public) - {"scipy.version"} else set()
    return sorted((set(HEAVY) - {"scipy"}) & sys.modules.keys() | scipy)

found = {}
for module, *arguments in json.loads(sys.argv[1]):
    tool, status = import_module(module).tool, 0
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            status = tool(arguments)
        except SystemExit as end:
            status = end.code
    assert not status, (module, status)
    found[module] = loaded()
print(json.dumps(found))
"""


def imports(*calls: tuple[str, ...]) -> dict[str, list[str]]:
    """Call tools, one after another in one process; return what of HEAVY is there after each.

    A call is the module of a tool and its arguments.
    """
    script = f"HEAVY = {HEAVY!r}\n{RUN}"
    return dict(json.loads(python(script, json.dumps(calls))))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from flock_sim.commands.reference import tool

    path = tmp_path_factory.mktemp("imports") / "run"
    assert tool(["--birds", "5", "--t-max", "50", "--output", str(path)]) == 0
    return path


def test_the_kernels_of_a_bird_are_loaded_before_processes_are_forked() -> None:
    script = (
        "from flock_sim.launcher.precompile import warm_bird, warm_exchange\n"
        "warm_bird()\n"
        "from flock_sim.protocol import bird_kernel, stage_words\n"
        "kernels = [*vars(bird_kernel).values(), *vars(stage_words).values()]\n"
        "print(*(k.__name__ for k in kernels if getattr(k, 'signatures', ()) == []))"
    )
    # These are called by other kernels only.
    inner = {"has_header", "put_header", "row", "_finite", "_is_stage", "_lack", "pointer"}
    inner |= {
        "_add_force",
        "compute_force",
        "canonical",
        "circulation_at",
        "compute_drags",
        "drag_of_pair",
        "move",
        "sum_up",
    }
    assert set(python(script).split()) <= inner


def test_help_needs_none_of_them() -> None:
    assert {"fly", "metrics", "limits", "sweep", "watch"} <= TOOLS.keys()
    found = imports(*((module, "--help") for module in WITHOUT_ROS))
    assert found == {module: [] for module in WITHOUT_ROS}


def test_what_is_said_of_recorded_flights_needs_no_compiler_and_no_ros(run: Path) -> None:
    found = imports(
        ("flock_tools.commands.metrics", str(run)),
        ("flock_tools.commands.compare", str(run), str(run)),
        ("flock_tools.commands.repair", str(run)),
    )
    assert set(map(tuple, found.values())) == {("numpy",)}


@pytest.mark.parametrize(
    ("tool", "arguments"),
    [("limits", ()), ("equilibrium", ()), ("arrange", ("--spans", "1,1.01,0.99"))],
)
def test_steady_states_of_nearest_neighbours_need_numba_alone(
    tool: str, arguments: tuple[str, ...]
) -> None:
    module = f"flock_tools.commands.{tool}"
    assert imports((module, *arguments)) == {module: ["numba", "numpy"]}


def test_clock_and_recorder_need_no_compiler() -> None:
    pytest.importorskip("rclpy")
    nodes = ", ".join(TOOLS[node] for node in ("clock", "recorder"))
    script = f"import sys, {nodes}; print(*sys.modules)"
    modules = set(python(script).split())
    assert modules & {*HEAVY, "rich"} == {"rclpy", "numpy"}


KERNEL = """
from flock_sim.physics.aerodynamics import even_part
assert even_part(2.0, 0.5, 0.5) < 0.0

import sys
from numba.misc.coverage_support import coverage_available
print("scipy.linalg" in sys.modules, coverage_available)
"""

PRODUCT = """
import numba
import numpy as np

@numba.njit
def product(matrix, vector):
    return matrix @ vector

applied = product(np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([1.0, -2.0]))
print(applied.tolist(), "scipy.linalg" in sys.modules)
"""


def test_a_product_of_matrices_is_compiled_after_our_kernels() -> None:
    assert python(KERNEL + PRODUCT).splitlines() == ["False False", "[0.0, -5.0] True"]


def test_what_numba_is_used_with_before_our_kernels_is_left_to_it() -> None:
    pytest.importorskip("coverage")  # numba has none in any case without it
    before = "import coverage, numba.np.arraymath"
    assert python(before + KERNEL).split() == ["True", "True"]

# SPDX-License-Identifier: Apache-2.0
"""The part of Flock without ROS 2, installed by pip alone in a new environment."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from flock_sim import Run
from support.flights import record

pytestmark = [pytest.mark.e2e, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[2]

NOTEBOOK = ROOT / "examples" / "gusty_formation.ipynb"

EXECUTE = ROOT / "tools" / "execute_notebook.py"


KERNELS = ROOT / "src/flock_sim/flock_sim/__pycache__/kernels"
"""The compiled kernels of this tree. The installed package has the same sources, and loads them."""


class Installed:
    """A new environment, and a new working directory."""

    def __init__(self, directory: Path) -> None:
        self.bin = directory / "venv" / "bin"
        self.work = directory / "work"
        self.work.mkdir()
        home = directory / "home"
        home.mkdir()
        keep = ("LANG", "PATH", "PIP_", "SSL_", "REQUESTS_", "https_proxy", "HTTPS_PROXY")
        self.environment = {
            **{name: value for name, value in os.environ.items() if name.startswith(keep)},
            "HOME": str(home),
            "XDG_CACHE_HOME": str(directory / "cache"),
        }
        (directory / "cache").mkdir()
        (directory / "cache" / "flock-kernels").symlink_to(KERNELS)

    def run(self, *command: str) -> str:
        done = subprocess.run(
            [self.bin / command[0], *command[1:]],
            cwd=self.work,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


def printed(notebook: Path) -> list[str]:
    """What the cells print, and a line for each picture."""
    found = []
    for cell in json.loads(notebook.read_text())["cells"]:
        for output in cell.get("outputs", []):
            assert output["output_type"] != "error"
            found += ["".join(output["text"])] if output["output_type"] == "stream" else []
            found += ["a picture"] if "image/png" in output.get("data", {}) else []
    return found


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    directory = tmp_path_factory.mktemp("pip")
    made = Installed(directory)
    venv = str(directory / "venv")
    pip = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check"]
    cache = subprocess.check_output([*pip, "cache", "dir"], text=True).strip()
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    subprocess.run(
        [*pip, "--python", venv, "install", "--quiet", "--no-compile", "--cache-dir", cache]
        + [f"{ROOT}[notebook]"],
        check=True,
        env=made.environment,
    )
    return made


def test_equilibrium_reference_metrics_and_the_notebook_work(
    installed: Installed, tmp_path: Path
) -> None:
    found = json.loads(installed.run("flockflight", "equilibrium", "--birds", "5", "--json"))
    assert found["exists"] == [True]

    installed.run(
        *("flockflight", "reference", "--birds", "5", "--t-max", "500", "--output", "run")
    )
    metrics = json.loads(installed.run("flockflight", "metrics", "run", "--json"))
    with Run(installed.work / "run") as run:
        assert record(tmp_path / "here", run.configuration).exists()
        with Run(tmp_path / "here") as here:
            assert here.state_digest == run.state_digest == metrics["state_digest"]

    installed.run("python", str(EXECUTE), "executed.ipynb")
    assert printed(installed.work / "executed.ipynb") == printed(NOTEBOOK)


def test_the_command_tells_its_tools_and_what_needs_ros(installed: Installed) -> None:
    told = installed.run("flockflight", "--help")
    assert "Predict\n  equilibrium " in told
    assert installed.run("flockflight", "--version").startswith("flockflight ")
    helped = installed.run("flockflight", "limits", "--help")
    assert "usage: flockflight limits" in helped
    assert "./flock" not in helped
    for name, error in (
        ("fly", "error: fly needs ROS 2: run ./flock fly in a clone of Flock\n"),
        ("limit", "error: there is no tool 'limit': did you mean 'limits'?"),
    ):
        done = subprocess.run(
            [installed.bin / "flockflight", name],
            env=installed.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 2
        assert done.stderr.startswith(error)


def test_a_flight_over_ros_is_refused_in_one_sentence(installed: Installed) -> None:
    script = "import flockflight as ff\ntry: ff.Flock(3).fly()\nexcept ff.FlockError as e: print(e)"
    told = installed.run("python", "-c", script)
    assert told.startswith("fly() needs ROS 2 (No module named 'rclpy'): use ./flock python")

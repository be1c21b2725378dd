# SPDX-License-Identifier: Apache-2.0
"""The files for containers and for the repository's host parse, and name what exists."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[3]

GITHUB = ROOT / ".github"

TARGETS = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)


def parsed(path: Path) -> Any:
    # BaseLoader keeps `on` and numbers as texts.
    return yaml.load(path.read_text(encoding="utf-8"), yaml.BaseLoader)


def packages(text: str) -> set[str]:
    """Return the packages that a text installs by apt-get."""
    (found,) = re.findall(r"apt-get install ((?:\\\n|[^&\n])*)", text)
    return {word for word in found.replace("\\\n", " ").split() if not word.startswith("-")}


def test_the_workflow_runs_all_checks_with_every_python() -> None:
    workflow = parsed(GITHUB / "workflows" / "ci.yml")
    assert workflow["on"].keys() == {"push", "pull_request"}
    (job,) = workflow["jobs"].values()
    assert job["runs-on"] == "ubuntu-24.04"
    (bounds,) = re.findall(
        r'requires-python = ">=3\.(\d+),<3\.(\d+)"', (ROOT / "pyproject.toml").read_text("utf-8")
    )
    assert job["strategy"]["matrix"]["python"] == [f"3.{n}" for n in range(*map(int, bounds))]
    (run,) = (step for step in job["steps"] if step.get("env"))
    assert run == {
        "name": "Run all checks",
        "run": ".ci/run",
        "env": {"PYTHON": "python${{ matrix.python }}"},
    }
    assert (ROOT / run["run"]).stat().st_mode & 0o111
    assert "PYTHON:-" in (ROOT / "tools" / "setup").read_text(encoding="utf-8")


def test_all_checks_run_the_tests_of_the_packages() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    targets = re.findall(r"^(?:\w+=\w+ )*make ([\w-]+)", script, re.M)
    assert {"lint", "docs", "test", "test-packages"} <= set(targets) <= set(TARGETS)
    for package in ("flock_interfaces", "flock_sim", "flock_tools", "flockflight"):
        assert list((ROOT / "src" / package / "test").glob("test_*.py"))


def test_forms_of_issues_ask_for_what_is_needed_to_repeat_a_fault() -> None:
    for name in ("bug", "feature"):
        form = parsed(GITHUB / "ISSUE_TEMPLATE" / f"{name}.yml")
        assert {"name", "description", "body"} <= form.keys()
        identifiers = [each["id"] for each in form["body"]]
        assert len(identifiers) == len(set(identifiers))
        for each in form["body"]:
            assert each["type"] in ("textarea", "input")
            assert each["attributes"]["label"]
    bug = parsed(GITHUB / "ISSUE_TEMPLATE" / "bug.yml")
    needed = {each["id"] for each in bug["body"] if each.get("validations", {}).get("required")}
    assert needed == {"command", "output", "expected", "version", "system"}


def test_templates_and_the_dockerfile_name_targets_and_files_that_exist() -> None:
    template = (GITHUB / "pull_request_template.md").read_text(encoding="utf-8")
    assert set(re.findall(r"`make ([\w-]+)`", template)) == {"lint", "test"} <= set(TARGETS)
    for name in re.findall(r"\b[A-Z]+\.md", template):
        assert (ROOT / name).exists()
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert set(re.findall(r"^RUN make (\w+)", dockerfile, re.M)) == {"setup"} <= set(TARGETS)
    assert 'CMD ["./flock", "--help"]' in dockerfile


def test_container_and_workflow_install_the_prerequisites_of_the_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"`sudo apt install ([^`]*)`", readme)
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert packages(dockerfile) == {*line.split(), "ca-certificates"}
    # The action that sets up Python brings its headers and the module venv.
    workflow = (GITHUB / "workflows" / "ci.yml").read_text(encoding="utf-8")
    assert packages(workflow) == set(line.split()) - {"python3-dev", "python3-venv"}


def test_the_development_container_is_built_from_the_dockerfile() -> None:
    path = ROOT / ".devcontainer" / "devcontainer.json"
    container = json.loads(path.read_text(encoding="utf-8"))
    dockerfile = (path.parent / container["build"]["dockerfile"]).resolve()
    assert dockerfile == ROOT / "Dockerfile"
    assert (path.parent / container["build"]["context"]).resolve() == ROOT
    assert f"AS {container['build']['target']}\n" in dockerfile.read_text(encoding="utf-8")
    assert container["postCreateCommand"].endswith("make setup")

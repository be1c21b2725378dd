# SPDX-License-Identifier: Apache-2.0
"""The packages below src/ name what they import, and agree with each other."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.package import Package, parse_package

ROOT = Path(__file__).parents[3]

PYTHON_PACKAGES = ("flock_sim", "flock_tools", "flockflight")

PACKAGES = ("flock_interfaces", *PYTHON_PACKAGES)

BY_PIP = {"distributed", "lz4", "mcap", "xarray", "zstandard"}
"""The imports without a rosdep key that apt resolves; docs/ros.md names them."""

TRANSITIVE = {"markupsafe": "jinja2"}
"""The imports that another one requires."""

KEYS = {"yaml": "python3-yaml"}
"""The rosdep keys of imports, where they are not python3-NAME."""

DISTRIBUTIONS = {"jinja2": "Jinja2", "yaml": "PyYAML"}
"""The names at PyPI of imports, where they differ."""

ONLY_WITH_ROS = {"setproctitle", "websockets"}
"""The requirements that the installation by pip alone does not have."""

PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def manifest(package: str) -> Package:
    return parse_package(str(ROOT / "src" / package / "package.xml"))


def setup_of(package: str) -> dict[str, Any]:
    """Return the literal arguments of setup() in a setup.py."""
    tree = ast.parse((ROOT / "src" / package / "setup.py").read_text(encoding="utf-8"))
    (call,) = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"
    )
    return {
        str(each.arg): ast.literal_eval(each.value)
        for each in call.keywords
        if not isinstance(each.value, ast.Call)
    }


def imports(package: str, folder: str) -> set[str]:
    """Return the names of the other packages that the modules of a folder import."""
    found = set()
    for path in (ROOT / "src" / package / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {each.name.partition(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).partition(".")[0])
    return found - {package} - sys.stdlib_module_names


def is_key(name: str, keys: set[str]) -> bool:
    return name in keys or f"python3-{name}" in keys


def python_imports(package: str) -> set[str]:
    """Return the imports from PyPI: those whose name no package of ROS has."""
    keys = {each.name for each in manifest(package).exec_depends}
    return {name for name in imports(package, package) if name not in keys} - TRANSITIVE.keys()


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_every_import_is_a_dependency_or_installed_by_pip(package: str) -> None:
    found = manifest(package)
    run = {each.name for each in found.exec_depends}
    test = run | {each.name for each in found.test_depends}
    assert {name for name in imports(package, package) if not is_key(name, run)} <= (
        BY_PIP | TRANSITIVE.keys()
    )
    launch = ROOT / "src" / package / "launch"
    assert not launch.exists() or imports(package, "launch") <= run
    assert {name for name in imports(package, "test") if not is_key(name, test)} == set()
    assert not (ROOT / "src" / package / "test" / "__init__.py").exists()  # it would be installed


def test_the_page_on_ros_names_what_pip_installs() -> None:
    page = (ROOT / "docs" / "ros.md").read_text(encoding="utf-8")
    (section,) = re.findall(r"^## With an installed ROS 2\n(.*)", page, re.M | re.S)
    (sentence,) = re.findall(r"no rosdep key[^.]*:([^.]*)\.", section)
    assert set(re.findall(r"`(\w+)`", sentence)) == BY_PIP
    used = set().union(*map(python_imports, PYTHON_PACKAGES))
    assert used >= BY_PIP


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_setup_requires_what_the_package_imports_from_pypi(package: str) -> None:
    needed = {DISTRIBUTIONS.get(name, name) for name in python_imports(package)}
    assert set(setup_of(package)["install_requires"]) == needed
    assert setup_of(package)["extras_require"] == {"test": ["pytest"]}


def test_an_installation_by_pip_requires_the_same() -> None:
    required = set().union(*(setup_of(package)["install_requires"] for package in PYTHON_PACKAGES))
    # pandas comes with xarray.
    lines = set(re.findall(r'^    "(\w+)>=|^cluster = \["(\w+)>=', PROJECT, re.M))
    assert {one or other for one, other in lines} == required - ONLY_WITH_ROS - {"pandas"}


def test_all_packages_have_one_version_and_say_the_same_of_themselves() -> None:
    (version,) = re.findall(r'^version = "(.*)"', PROJECT, re.M)
    (citation,) = re.findall(r"^version: (.*)", (ROOT / "CITATION.cff").read_text("utf-8"), re.M)
    (description,) = re.findall(r'^description = "(.*)"', PROJECT, re.M)
    assert citation == version
    for package in PACKAGES:
        found = manifest(package)
        assert found.version == version
        assert [author.name for author in found.authors] == ["The Flock authors"]
        assert "python3-pytest" in {each.name for each in found.test_depends}
    for package in PYTHON_PACKAGES:
        told = setup_of(package)
        assert (told["name"], told["version"]) == (package, version)
        assert (told["description"], told["license"]) == (
            manifest(package).description,
            *manifest(package).licenses,
        )
    assert setup_of("flockflight")["description"] == description


@pytest.mark.parametrize("package", PACKAGES)
def test_the_changelog_of_a_package_can_be_read_by_bloom(package: str) -> None:
    text = (ROOT / "src" / package / "CHANGELOG.rst").read_text(encoding="utf-8")
    # As catkin_prepare_release does, since the parser passes over what is not released.
    title, date = "Forthcoming\n-----------\n", "2000-01-01"
    assert text.count(title) == 1
    released = text.replace(title, f"1.2.3 ({date})\n------------------\n")
    changelog = populate_changelog_from_rst(Changelog(package), released)
    ((version, released_on, content),) = changelog.foreach_version()
    assert (version, str(released_on.date())) == ("1.2.3", date)
    assert ["CHANGELOG.md" in str(entry) for entry in content] == [True]

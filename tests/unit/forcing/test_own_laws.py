# SPDX-License-Identifier: Apache-2.0
"""Laws are found in files and in installed packages, as they are now; others are refused."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.forcing.own_laws import PLACES, load, place
from flock_sim.forcing.registry import digests_of, model_of, own_laws
from flock_sim.reference.integrator import Reference
from support.own_laws import law_file

PULL = "def pull(force=0.1): return force\n"


@pytest.fixture(autouse=True)
def _places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Restore the files of laws that a test places."""
    monkeypatch.setenv(PLACES, "{}")


def flown(name: str, **parameters: object) -> float:
    flock = FlockConfiguration.given({"birds": 1, "t_max": 1.0, "forcing": [name], **parameters})
    flight = Reference(flock)
    flight.advance(1)
    return float(flight.speed[0, 0])


def digest(file: Path) -> str:
    return f"sha256:{hashlib.sha256(file.read_bytes()).hexdigest()}"


# source (None: no file), name of the law -> words of the message
REFUSED = [
    (None, "pull", ["laws.py", "No such file", "name a readable law file"]),
    ("def pull(force)\n    return force\n", "pull", ["laws.py, line 1", "SyntaxError"]),
    ("import math\nimport wind_tunnel\n", "pull", ["line 2", "ModuleNotFoundError", "wind_tunnel"]),
    (
        "def ratio():\n    return 1 / 0\n\n\nratio()\n",
        "pull",
        ["laws.py, line 2", "ZeroDivisionError"],
    ),
    ("import sys\nsys.exit('no\\nlaws today')\n", "pull", ["line 2", "SystemExit: no laws today"]),
    (PULL, "pul", ["has no function 'pul'", "did you mean 'pull'?", "known are pull"]),
    (PULL, "", ["has no function ''"]),
    ("X = 3.0\n", "X", ["has no function 'X'", "it has no function"]),
    ("class pull: pass\n", "pull", ["has no function 'pull'"]),
    ("from math import sqrt as pull\n", "pull", ["has no function 'pull'"]),
]


@pytest.mark.parametrize(("source", "law", "words"), REFUSED)
def test_a_file_without_the_law_is_refused_in_one_line(
    source: str | None, law: str, words: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "laws.py" if source is None else law_file(tmp_path, source)
    modules = {name for name in sys.modules if name.startswith("flock_law_")}
    with pytest.raises(FlockError) as caught:
        FlockConfiguration.given({"forcing": [f"{path}:{law}"]})
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.exit_status == 2
    for word in words:
        assert word in message, message
    if "has no function" not in message:
        assert {name for name in sys.modules if name.startswith("flock_law_")} == modules


def test_a_file_without_the_name_of_a_law_is_no_law(tmp_path: Path) -> None:
    path = law_file(tmp_path, PULL)
    with pytest.raises(FlockError, match=r"laws\.py is a file: name a law in it, as .*py:LAW$"):
        FlockConfiguration.given({"forcing": [str(path)]})


def test_a_directory_is_no_file_of_laws(tmp_path: Path) -> None:
    (tmp_path / "laws.py").mkdir()
    with pytest.raises(FlockError, match=r"law file .*laws\.py: Is a directory; name a readable"):
        load([f"{tmp_path}/laws.py:pull"])


def test_a_file_is_run_once_and_nothing_is_written_beside_it(tmp_path: Path) -> None:
    path = law_file(tmp_path, f"open({str(tmp_path / 'ran')!r}, 'a').write('x')\n{PULL}")
    name = f"{path}:pull"
    for _ in range(3):
        load([name])
    assert (tmp_path / "ran").read_text() == "x"
    assert {entry.name for entry in tmp_path.iterdir()} == {"laws.py", "ran"}
    assert digests_of([name, "gust"]) == {name: digest(path)}


def test_a_file_that_has_changed_is_loaded_again(tmp_path: Path) -> None:
    name = f"{law_file(tmp_path, PULL)}:pull"
    first = flown(name)
    assert flown(f"{name}:force=0.2") > first
    law_file(tmp_path, "def pull(strength=0.2): return strength\n")
    assert flown(name) == flown("constant:force=0.2")
    assert flown(f"{name}:strength=0.1") == first
    with pytest.raises(FlockError, match="unknown key 'force'"):
        flown(f"{name}:force=0.1")


def test_a_law_is_named_by_its_path_from_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    law_file(tmp_path, PULL)
    monkeypatch.chdir(tmp_path)
    assert flown("laws.py:pull:force=0.2") == flown("constant:force=0.2")
    assert flown("./laws.py:pull:force=0.2") == flown("constant:force=0.2")


def test_a_law_has_the_meaning_of_its_docstring_and_its_parameters(tmp_path: Path) -> None:
    source = 'def pull(bird, noise, force, gain=2):\n    "Pull.\\n\\nMuch."\n    return force\n'
    name = f"{law_file(tmp_path, source)}:pull"
    load([name])
    model = model_of(name)
    assert model is not None
    assert model.meaning == "Pull."
    assert {key: bounds.default for key, bounds in model.keys.items()} == {
        "force": None,
        "gain": 2.0,
        "seed": 0.0,
    }


def test_the_name_of_a_built_in_model_is_that_model(tmp_path: Path) -> None:
    load(["gust", "constant"])
    assert not {"gust", "constant"} & own_laws().keys()


def installed(directory: Path, points: str, source: str = PULL) -> None:
    """Install a package of laws in `directory`, as pip would."""
    (directory / "my_laws.py").write_text(source, encoding="utf-8")
    information = directory / "my_laws-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my-laws\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[flock.forcing]\n{points}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory of packages that is on the path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_laws", raising=False)
    return tmp_path


def test_laws_of_installed_packages_are_found_by_their_names(site: Path) -> None:
    installed(site, "tow = my_laws:pull")
    assert flown("tow:force=0.2") == flown("constant:force=0.2")
    assert digests_of(["tow"]) == {"tow": digest(site / "my_laws.py")}
    with pytest.raises(FlockError) as caught:
        flown("towe:force=0.2")
    for word in ("unknown model 'towe'", "did you mean 'tow'?", "constant, sine, keeper, gust"):
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("points", "source", "words"),
    [
        ("bad = my_laws:push", PULL, "law 'bad' of my_laws:push: AttributeError"),
        ("bad = no_laws:pull", PULL, "law 'bad' of no_laws:pull: ModuleNotFoundError"),
        ("bad = my_laws:pull", "pull = 3.0\n", "law 'bad' of my_laws:pull: must be a function"),
        ("bad = my_laws:pull", "1 / 0\n", "law 'bad' of my_laws:pull: ZeroDivisionError"),
        ("bad = my_laws:pull", "def pull(bird, *a): return 0.0\n", r"its argument \*a must have"),
    ],
)
def test_a_broken_installed_law_is_refused_in_one_line(
    points: str, source: str, words: str, site: Path
) -> None:
    installed(site, points, source)
    with pytest.raises(FlockError, match=words) as caught:
        load(["bad"])
    assert "\n" not in str(caught.value)


def test_laws_of_a_bag_are_those_of_the_files_that_the_user_names(tmp_path: Path) -> None:
    """The name is that of the flight; the file may be elsewhere, and its content counts."""
    name = f"{tmp_path}/then/laws.py:pull"
    now = law_file(tmp_path, PULL, "moved.py")
    place({name: digest(now)}, [str(now)], "the bag")
    assert str(now) in os.environ[PLACES]
    assert flown(f"{name}:force=0.2") == flown("constant:force=0.2")


def test_a_file_of_several_laws_is_named_once(tmp_path: Path) -> None:
    now = law_file(tmp_path, f"{PULL}def push(): return -0.1\n")
    recorded = {f"then/laws.py:{law}": digest(now) for law in ("pull", "push")}
    place(recorded, [str(now)], "the bag")
    assert digests_of(recorded) == recorded


def test_laws_of_a_bag_that_are_not_named_or_not_the_same_are_refused(
    tmp_path: Path, site: Path
) -> None:
    installed(site, "tug = my_laws:pull")
    now = law_file(tmp_path, PULL)
    was = law_file(tmp_path, f"{PULL}# as it was\n", "was.py")
    name, given = "then/laws.py:pull", str(now)
    for recorded, laws, words in (
        ({name: digest(was)}, [], r"the bag: it was flown with the law .*--law then/laws\.py"),
        ({name: digest(was)}, [given], r"flown with then/laws\.py:pull of digest sha256:.* name"),
        ({name: digest(now)}, [given, str(was)], r"flown without --law .*was\.py; leave it out"),
        ({}, [given], r"flown without --law .*laws\.py; leave it out"),
        ({name: digest(now)}, [str(tmp_path / "no.py")], r"law file .*no\.py: No such file"),
        ({"tug": digest(now)}, [], r"flown with the law tug, .*--law tug"),
        ({"tug": digest(was)}, ["tug"], r"it was flown with tug of digest sha256:"),
    ):
        with pytest.raises(FlockError, match=words) as caught:
            place(recorded, laws, "the bag")
        assert "\n" not in str(caught.value)
        assert caught.value.exit_status == 2

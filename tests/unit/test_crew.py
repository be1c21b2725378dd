# SPDX-License-Identifier: Apache-2.0
"""A crew's processes are watched, named when they fail, and never left behind."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from flock_sim import crew as module
from flock_sim.crew import SUPERVISED, Crew
from flock_sim.errors import RunFailed

HANDS = {
    "well": "pass",
    "badly": "raise SystemExit(3)",
    "waits": "import time\nReady()\ntime.sleep(1000)",
    "deaf": "import signal, time\nsignal.signal(15, signal.SIG_IGN)\nReady()\ntime.sleep(1000)",
    "tells": (
        "import os, pathlib, sys\n"
        "read = [pathlib.Path(file).read_text() for file in sys.argv[4::2]]\n"
        f"said = (sys.argv[1:], os.environ.get('{SUPERVISED}'), read)\n"
        "pathlib.Path('told').write_text(repr(said))"
    ),
}
READY = "import os, pathlib\ndef Ready(): pathlib.Path(f'ready-{os.getpid()}').touch()\n"


@pytest.fixture
def hands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Modules for a crew to run, in the working directory."""
    for name, code in HANDS.items():
        (tmp_path / f"hand_{name}.py").write_text(READY + code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def ready(hands: Path, count: int) -> list[int]:
    """Wait until `count` hands have come up; return their process ids."""
    until(lambda: len(list(hands.glob("ready-*"))) == count)
    return [int(path.name.partition("-")[2]) for path in hands.glob("ready-*")]


def lives(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists()


def test_all_that_end_well_are_joined(hands: Path) -> None:
    with Crew({}) as crew:
        crew.start("one", "hand_well", {})
        crew.start("two", "hand_well", {})
        crew.join(30.0)
        crew.check()


def test_a_hand_is_told_its_parameters_and_that_it_is_supervised(hands: Path) -> None:
    output = "runs/a: b #c"  # on a command line, ROS would read it as YAML
    with Crew({"birds": 3}) as crew:
        crew.start("one", "hand_tells", {"run_id": 7, "indices": [1, 2], "output": output})
        crew.join(30.0)
    told, supervised, read = ast.literal_eval((hands / "told").read_text())
    assert supervised == str(os.getpid())
    assert told[:2] == ["--ros-args", "--disable-external-lib-logs"]
    assert told[2::2] == ["--params-file", "--params-file"]
    own = {"run_id": 7, "indices": [1, 2], "output": output}
    assert [yaml.safe_load(text) for text in read] == [
        {"/**": {"ros__parameters": parameters}} for parameters in ({"birds": 3}, own)
    ]


def test_one_that_fails_is_named_with_its_status(hands: Path) -> None:
    with Crew({}) as crew:
        crew.start("the good one", "hand_well", {})
        crew.start("the bad one", "hand_badly", {})
        with pytest.raises(RunFailed, match=r"^the bad one ended with status 3$"):
            crew.join(30.0)


def test_one_that_is_killed_is_named_with_the_signal(hands: Path) -> None:
    with Crew({}) as crew:
        crew.start("the victim", "hand_waits", {})
        crew.check()
        os.kill(ready(hands, 1)[0], signal.SIGKILL)
        with pytest.raises(RunFailed, match=r"^the victim was killed by SIGKILL$"):
            crew.join(30.0)


def test_those_that_do_not_end_are_named_where_they_had_to(hands: Path) -> None:
    with Crew({}) as crew:
        crew.start("one", "hand_waits", {}, to_the_end=True)
        crew.start("two", "hand_well", {})
        crew.start("three", "hand_waits", {}, to_the_end=True)
        pids = ready(hands, 2)
        until(lambda: crew._hands[1].process.poll() is not None)
        with pytest.raises(RunFailed, match=r"^one and three did not end within 0\.1 s"):
            crew.join(0.1)
    assert not any(map(lives, pids))


def test_those_that_do_not_end_and_are_needed_no_more_are_ended_with_a_note(
    hands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Crew({}) as crew:
        crew.start("one", "hand_waits", {})
        crew.start("two", "hand_well", {}, to_the_end=True)
        pids = ready(hands, 1)
        until(lambda: crew._hands[1].process.poll() is not None)
        crew.join(0.1)
    said = "one did not end within 0.1 s of the flight's end: ended by force\n"
    assert capsys.readouterr().err == said
    assert not any(map(lives, pids))


def test_ctrl_c_is_left_to_the_parent_from_the_first_moment_on(hands: Path) -> None:
    (hands / "hand_says.py").write_text(
        "import pathlib, signal\n"
        "deaf = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "pathlib.Path('deaf').write_text(repr(deaf))\n"
    )
    with Crew({}) as crew:
        crew.start("one", "hand_says", {})
        crew.join(30.0)
    assert (hands / "deaf").read_text() == "True"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_nobody_is_left_however_a_flight_ends(hands: Path, error: type[BaseException]) -> None:
    pids = []

    def fail() -> None:
        with Crew({}) as crew:
            crew.start("one", "hand_waits", {})
            crew.start("two", "hand_waits", {})
            pids.extend(ready(hands, 2))
            raise error

    with pytest.raises(error):
        fail()
    assert len(pids) == 2
    assert not any(map(lives, pids))


def test_who_does_not_heed_a_polite_word_is_killed(
    hands: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "GRACE", 0.1)
    with Crew({}) as crew:
        crew.start("one", "hand_deaf", {})
        (pid,) = ready(hands, 1)
    assert not lives(pid)


def test_one_that_is_stopped_is_ended_in_order(
    hands: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "GRACE", 30.0)
    with Crew({}) as crew:
        crew.start("one", "hand_waits", {})
        (pid,) = ready(hands, 1)
        os.kill(pid, signal.SIGSTOP)
        process: subprocess.Popen[bytes] = crew._hands[0].process
    assert process.returncode == -signal.SIGTERM

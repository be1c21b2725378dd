# SPDX-License-Identifier: Apache-2.0
"""A supervisor watches its processes, names those that fail, and leaves none behind."""

from __future__ import annotations

import ast
import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
import yaml

from flock_sim.console.signals import SUPERVISED
from flock_sim.errors import RunFailed
from flock_sim.launcher import supervisor as module
from flock_sim.launcher.fork_server import ForkServer
from flock_sim.launcher.supervisor import Supervisor
from support.terminal import lives, parent

CHILDREN = {
    "well": "pass",
    "badly": "raise SystemExit(3)",
    "waits": "import time\nReady()\ntime.sleep(1000)",
    "deaf": "import signal, time\nsignal.signal(15, signal.SIG_IGN)\nReady()\ntime.sleep(1000)",
    "tells": (
        "import os, pathlib, sys\n"
        "files = [word for word in sys.argv if word.startswith('/proc/')]\n"
        "read = [pathlib.Path(file).read_text() for file in files]\n"
        f"said = (sys.argv[1:], os.environ.get('{SUPERVISED}'), str(os.getppid()), read)\n"
        "pathlib.Path('told').write_text(repr(said))"
    ),
}
READY = "import os, pathlib\ndef Ready(): pathlib.Path(f'ready-{os.getpid()}').touch()\n"
MAIN = """
def main():
    {}
if __name__ == "__main__":
    main()
"""

MakeSupervisor = Callable[..., Supervisor]


@pytest.fixture
def children(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Modules for a supervisor to run, in the working directory."""
    for name, code in CHILDREN.items():
        (tmp_path / f"child_{name}.py").write_text(module_of(code))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def module_of(code: str) -> str:
    return READY + MAIN.format(code.replace("\n", "\n    "))


@pytest.fixture(params=["forked", "new"])
def make_supervisor(request: pytest.FixtureRequest, children: Path) -> Iterator[MakeSupervisor]:
    """Make a supervisor whose processes are forked, or new ones."""
    if request.param == "new":
        yield Supervisor
        return
    server = ForkServer.spawn("os:getpid")
    yield partial(Supervisor, server=server)
    assert server.gone


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def ready(children: Path, count: int) -> list[int]:
    """Wait until `count` children have come up; return their process ids."""
    until(lambda: len(list(children.glob("ready-*"))) == count)
    return [int(path.name.partition("-")[2]) for path in children.glob("ready-*")]


def test_all_that_end_well_are_joined(make_supervisor: MakeSupervisor, children: Path) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_well", {})
        supervisor.start("two", "child_well", {})
        supervisor.join(30.0)


def test_one_that_ends_before_the_flight_does_is_restarted(
    make_supervisor: MakeSupervisor, children: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with make_supervisor({}, True) as supervisor:
        supervisor.start("the early one", "child_well", {})
        until(lambda: supervisor._children[0].process.poll() is not None)
        supervisor.check()
        assert supervisor.deaths == 1
        with pytest.raises(RunFailed, match="before the flight was over, 6 times without any prog"):
            until(lambda: supervisor.check())
    assert (
        "the early one ended before the flight was over: started again" in capsys.readouterr().err
    )


def test_without_restarts_one_that_ends_early_ends_the_flight(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("the early one", "child_well", {})
        with pytest.raises(RunFailed, match="the early one ended before the flight was over"):
            until(lambda: supervisor.check())


def test_a_child_is_told_its_parameters_and_that_it_is_supervised(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    output = "runs/a: b #c"  # on a command line, ROS would read it as YAML
    ros = ("--ros-args", "-r", "__ns:=/left")
    with make_supervisor({"birds": 3}, ros_arguments=ros) as supervisor:
        supervisor.start("one", "child_tells", {"run_id": 7, "indices": [1, 2], "output": output})
        supervisor.join(30.0)
    told, supervised, told_by, read = ast.literal_eval((children / "told").read_text())
    assert supervised == told_by
    assert told[:4] == [*ros, "--ros-args"]
    assert told[4::2] == ["--params-file", "--params-file"]
    own = {"run_id": 7, "indices": [1, 2], "output": output}
    assert [yaml.safe_load(text) for text in read] == [
        {"/**": {"ros__parameters": parameters}} for parameters in ({"birds": 3}, own)
    ]


def test_one_that_fails_is_named_with_its_status(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("the good one", "child_well", {})
        supervisor.start("the bad one", "child_badly", {})
        with pytest.raises(RunFailed, match=r"^the bad one ended with status 3$"):
            supervisor.join(30.0)


def test_one_that_is_killed_is_named_with_the_signal(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("the victim", "child_waits", {})
        supervisor.check()
        os.kill(ready(children, 1)[0], signal.SIGKILL)
        with pytest.raises(RunFailed, match=r"^the victim was killed by SIGKILL$"):
            supervisor.join(30.0)


def test_those_that_do_not_end_are_named_where_they_had_to(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_waits", {}, to_the_end=True)
        supervisor.start("two", "child_well", {})
        supervisor.start("three", "child_waits", {}, to_the_end=True)
        pids = ready(children, 2)
        until(lambda: supervisor._children[1].process.poll() is not None)
        with pytest.raises(RunFailed, match=r"^one and three did not end within 0\.1 s"):
            supervisor.join(0.1)
    assert not any(map(lives, pids))


def test_those_that_do_not_end_and_are_needed_no_more_are_ended_with_a_note(
    make_supervisor: MakeSupervisor, children: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_waits", {})
        supervisor.start("two", "child_well", {}, to_the_end=True)
        pids = ready(children, 1)
        until(lambda: supervisor._children[1].process.poll() is not None)
        supervisor.join(0.1)
    said = "one did not end within 0.1 s of the flight's end: ended by force\n"
    assert capsys.readouterr().err == said
    assert not any(map(lives, pids))


def test_ctrl_c_is_left_to_the_parent_from_the_first_moment_on(
    make_supervisor: MakeSupervisor, children: Path
) -> None:
    code = (
        "import pathlib, signal\n"
        "blocked = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])\n"
        "ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN\n"
        "pathlib.Path('deaf').write_text(repr(blocked or ignored))"
    )
    (children / "child_says.py").write_text(module_of(code))
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_says", {})
        supervisor.join(30.0)
    assert (children / "deaf").read_text() == "True"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_nobody_is_left_however_a_flight_ends(
    make_supervisor: MakeSupervisor, children: Path, error: type[BaseException]
) -> None:
    pids = []

    def fail() -> None:
        with make_supervisor({}) as supervisor:
            supervisor.start("one", "child_waits", {})
            supervisor.start("two", "child_waits", {})
            pids.extend(ready(children, 2))
            raise error

    with pytest.raises(error):
        fail()
    assert len(pids) == 2
    assert not any(map(lives, pids))


def test_who_does_not_heed_a_polite_word_is_killed(
    make_supervisor: MakeSupervisor, children: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "GRACE", 0.1)
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_deaf", {})
        (pid,) = ready(children, 1)
    assert not lives(pid)


def test_one_that_is_stopped_is_ended_in_order(
    make_supervisor: MakeSupervisor, children: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "GRACE", 30.0)
    with make_supervisor({}) as supervisor:
        supervisor.start("one", "child_waits", {})
        (pid,) = ready(children, 1)
        os.kill(pid, signal.SIGSTOP)
        process = supervisor._children[0].process
    assert process.returncode == -signal.SIGTERM


def test_without_its_server_a_supervisor_goes_on_with_new_processes(
    children: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    server = ForkServer.spawn("os:getpid")
    with Supervisor({}, respawn=True, server=server) as supervisor:
        supervisor.start("one", "child_waits", {})
        (pid,) = ready(children, 1)
        os.kill(parent(pid), signal.SIGKILL)
        until(lambda: server.update() or server.gone)
        os.kill(pid, signal.SIGKILL)
        until(lambda: supervisor._children[0].process.poll() is not None)
        supervisor.check()
        (again,) = set(ready(children, 2)) - {pid}
        assert parent(again) == os.getpid()
    said = capsys.readouterr().err
    assert "one was killed by SIGKILL: started again" in said
    assert "from now on processes start without the fork server, which is slower" in said

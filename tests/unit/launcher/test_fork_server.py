# SPDX-License-Identifier: Apache-2.0
"""A forked process behaves as a new one. A process that must not be forked is not forked."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from flock_sim.console.signals import SUPERVISED
from flock_sim.launcher.fork_server import Child, ForkServer
from flock_sim.launcher.forkable import CannotFork, check_forkable
from flock_sim.launcher.forked_program import Program
from support.python_process import python
from support.terminal import lives, parent

Start = Callable[..., Child]


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ForkServer]:
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    opened = ForkServer.spawn("os:getpid")
    yield opened
    opened.close()


@pytest.fixture
def start(server: ForkServer, tmp_path: Path) -> Start:
    """Start `code` as the function main of a module of its own."""
    count = iter(range(100))

    def start(code: str, files: Mapping[int, int] | None = None, **options: object) -> Child:
        name = f"program_{next(count)}"
        lines = "\n    ".join(code.splitlines())
        (tmp_path / f"{name}.py").write_text(f"import os, sys\ndef main():\n    {lines}\n")
        program = Program(name, ["--one", "two"], "name", directory=str(tmp_path), **options)
        with open(os.devnull, "r+b") as nothing:
            standard = dict.fromkeys(range(3), nothing.fileno())
            return server.start(program, {**standard, **(files or {})})

    return start


@pytest.mark.parametrize(
    ("code", "status"),
    [
        ("return 0", 0),
        ("return None", 0),
        ("return 3", 3),
        ("sys.exit(4)", 4),
        ("sys.exit()", 0),
        ("sys.exit('a reason')", 1),
        ("raise ValueError", 1),
        ("os.kill(os.getpid(), 9)", -signal.SIGKILL),
        ("os.kill(os.getpid(), 15)", -signal.SIGTERM),
    ],
)
def test_its_end_is_told_as_that_of_a_new_process(start: Start, code: str, status: int) -> None:
    child = start(code)
    assert child.wait(30.0) == status
    assert child.poll() == status


def test_it_has_arguments_environment_directory_and_files_and_no_others(
    start: Start, tmp_path: Path
) -> None:
    code = (
        "listed = sorted(map(int, os.listdir('/proc/self/fd')))\n"
        "files = [number for number in listed if os.path.exists(f'/proc/self/fd/{number}')]\n"
        "told = sys.argv, dict(os.environ), os.getcwd(), files, os.read(7, 9)\n"
        "print(told)\n"
        "print('a word', file=sys.stderr)"
    )
    (tmp_path / "in").write_text("what is 7")
    with (
        (tmp_path / "in").open("rb") as given,
        (tmp_path / "out").open("wb") as out,
        (tmp_path / "err").open("wb") as err,
    ):
        files = {7: given.fileno(), 1: out.fileno(), 2: err.fileno()}
        assert start(code, files, environment={"ONLY": "this"}).wait(30.0) == 0
    arguments, environment, directory, numbers, read = ast.literal_eval(
        (tmp_path / "out").read_text()
    )
    assert arguments == ["program_0", "--one", "two"]
    assert environment == {"ONLY": "this"}
    assert directory == str(tmp_path)
    assert numbers == [0, 1, 2, 7]
    assert read == b"what is 7"
    assert (tmp_path / "err").read_text() == "a word\n"


def test_files_may_change_places(start: Start, tmp_path: Path) -> None:
    """The numbers that they get may be those that others of them have in the server."""
    names = [tmp_path / str(number) for number in range(10)]
    opened = [name.open("w+") for name in names]
    numbers = list(range(3, 13))
    files = dict(zip(reversed(numbers), (file.fileno() for file in opened)))
    code = "for number in range(3, 13): os.write(number, str(number).encode())"
    assert start(code, files).wait(30.0) == 0
    assert [int(name.read_text()) for name in names] == numbers[::-1]


def test_functions_that_it_registers_for_its_end_are_called(start: Start, tmp_path: Path) -> None:
    code = "import atexit, pathlib\natexit.register(pathlib.Path('ended').touch)"
    assert start(code).wait(30.0) == 0
    assert (tmp_path / "ended").exists()


def test_signals_are_those_of_a_new_process(start: Start, tmp_path: Path) -> None:
    """The server ignores them, so that a Ctrl-C or a kill of the group leaves it to its client."""
    code = (
        "import signal, pathlib\n"
        "heard = [signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)]\n"
        "right = heard == [signal.SIG_DFL, signal.SIG_DFL, signal.default_int_handler]\n"
        "return 0 if right and not signal.pthread_sigmask(signal.SIG_BLOCK, []) else 5"
    )
    assert start(code).wait(30.0) == 0


def test_a_supervised_one_is_told_so_and_leaves_ctrl_c_to_its_parent(start: Start) -> None:
    code = (
        "import signal\n"
        "ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN\n"
        f"return 0 if ignored and os.environ['{SUPERVISED}'] == str(os.getppid()) else 5"
    )
    assert start(code, supervised=True).wait(30.0) == 0


def test_it_has_a_session_of_its_own_if_asked(start: Start) -> None:
    code = "return 0 if os.getsid(0) == os.getpid() else 5"
    assert start(code, new_session=True).wait(30.0) == 0
    assert start(code).wait(30.0) == 5


def test_waiting_for_one_that_goes_on_has_an_end(start: Start) -> None:
    child = start("import time\ntime.sleep(1000)")
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.05)
    child.kill()
    assert child.wait(30.0) == -signal.SIGKILL
    child.send_signal(signal.SIGTERM)  # to nobody


def test_of_many_at_a_time_each_has_its_own_status(start: Start) -> None:
    children = [start(f"return {status}") for status in range(40)]
    assert [child.wait(30.0) for child in reversed(children)] == list(reversed(range(40)))


def test_a_server_that_is_killed_is_noticed(
    server: ForkServer, start: Start, tmp_path: Path
) -> None:
    code = (
        "import pathlib, signal, time\n"
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "pathlib.Path('ready').touch()\n"
        "time.sleep(1000)"
    )
    child = start(code)
    until((tmp_path / "ready").exists)
    os.kill(parent(child.pid), signal.SIGKILL)
    until(lambda: server.update() or server.gone)
    with pytest.raises(CannotFork):
        start("return 0")
    assert child.poll() is None  # it has only lost its parent
    child.kill()
    assert child.wait(30.0) == -signal.SIGKILL


def test_a_server_that_does_not_answer_in_time_is_asked_no_more() -> None:
    server = ForkServer.spawn("os:getpid", timeout=0.0)
    program = Program("platform", [], "late")
    with pytest.raises(CannotFork, match="does not answer within 0 s"):
        server.start(program, {})
    # Its late answer must not pass for the one to a later request.
    with pytest.raises(CannotFork):
        server.start(program, {})
    assert server.gone
    server.close()


def test_children_end_with_their_server(server: ForkServer, start: Start) -> None:
    child = start("import time\ntime.sleep(1000)")
    os.kill(parent(child.pid), signal.SIGKILL)
    until(lambda: not lives(child.pid))
    assert child.wait(30.0) != 0


def test_a_server_ends_with_its_client(tmp_path: Path) -> None:
    code = (
        "from flock_sim.launcher.fork_server import ForkServer\n"
        "server = ForkServer.fork()\n"
        "print(open('/proc/self/task/%d/children' % __import__('os').getpid()).read())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    pid = int(done.stdout)
    until(lambda: not lives(pid))


def test_what_a_process_does_at_its_end_its_copies_do_not(tmp_path: Path) -> None:
    code = (
        "import atexit, os, sys, tempfile\n"
        "from flock_sim.launcher.fork_server import ForkServer\n"
        "from flock_sim.launcher.forked_program import Program\n"
        "atexit.register(print, 'once')\n"
        "with tempfile.TemporaryDirectory(dir=sys.argv[1]) as directory:\n"
        "    server = ForkServer.fork()\n"
        "    program = Program('ends', [], 'name')\n"
        "    child = server.start(program, {0: 0, 1: 1, 2: 2})\n"
        "    assert child.wait(30.0) == 0\n"
        "    assert os.path.isdir(directory)\n"
    )
    (tmp_path / "ends.py").write_text(
        "import tempfile\ndef main():\n    global kept\n    kept = tempfile.TemporaryDirectory()\n"
    )
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ['PYTHONPATH']}"}
    environment["TMPDIR"] = str(tmp_path / "temporary")
    (tmp_path / "temporary").mkdir()
    command = [sys.executable, "-W", "ignore", "-c", code, tmp_path]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "once\n"
    assert not list((tmp_path / "temporary").iterdir())  # but it does what is its own


def test_a_process_with_threads_is_not_forked() -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        with pytest.raises(CannotFork, match="threads"):
            check_forkable()
        with pytest.raises(CannotFork, match="threads"):
            ForkServer.fork()
    finally:
        over.set()
        thread.join()


def test_what_a_flight_preloads_neither_starts_threads_nor_initialises_ros() -> None:
    code = (
        "import os, sys, threading\n"
        "os.environ['OPENBLAS_NUM_THREADS'] = '1'  # as fly does\n"
        "from flock_sim.launcher.forkable import check_forkable\n"
        "from flock_sim.launcher.preload import preload\n"
        "preload()\n"
        "check_forkable()\n"
        "import rclpy\n"
        "assert not rclpy.ok() and threading.active_count() == 1\n"
        "from flock_sim.nodes.executables import module_of\n"
        "for node in ('bird', 'clock', 'recorder'):\n"
        "    assert callable(sys.modules[module_of(node)].main)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_log_message_of_a_forked_process_resolves_the_paths_of_few_modules() -> None:
    code = (
        "import inspect\n"
        "from rclpy.logging import get_logger\n"
        "from flock_sim.launcher.preload import preload\n"
        "preload()\n"
        "resolved, original = [], inspect.getabsfile\n"
        "inspect.getabsfile = lambda *of: resolved.append(of) or original(*of)\n"
        "assert get_logger('a').info('b')\n"
        "print(len(resolved))\n"
    )
    assert 0 < int(python(code)) < 20


def test_a_server_whose_preloading_starts_a_thread_refuses_to_fork(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "starts.py").write_text(
        "import threading, time\n"
        "def a_thread():\n"
        "    threading.Thread(target=time.sleep, args=(1000,), daemon=True).start()\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    server = ForkServer.spawn("starts:a_thread")
    with pytest.raises(CannotFork, match="threads"):
        server.start(Program("os", [], "name"), {0: 0, 1: 1, 2: 2})
    server.close()


@pytest.fixture
def client(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Start a client of a server that listens, and have it run `code` as a node does."""
    package = tmp_path / "flock_sim_nodes.py"
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    package.write_text(
        "import sys, types\n"
        "def preload():\n"
        "    node = types.ModuleType('flock_sim.nodes.node_process')\n"
        "    def main():\n"
        "        exec(sys.argv[1], {})\n"
        "    node.main = main\n"
        "    sys.modules['flock_sim.nodes.node_process'] = node\n"
    )
    server = ForkServer.spawn("flock_sim_nodes:preload", listen=True)

    def start(code: str, address: str = server.address) -> subprocess.Popen[str]:
        words = ["flock_sim.launcher.fork_client", address, "lib/node", code]
        return subprocess.Popen(
            [sys.executable, "-P", "-m", *words], stdout=subprocess.PIPE, text=True, cwd=tmp_path
        )

    yield start
    server.close()


FOREVER = "import os, time; print(os.getpid(), flush=True); time.sleep(1000)"


@pytest.mark.parametrize("status", [0, 3])
def test_a_client_ends_with_the_status_of_its_node(
    client: Callable[[str], subprocess.Popen[str]], status: int
) -> None:
    ended = client(f"import sys; print('said'); sys.exit({status})")
    assert ended.communicate(timeout=30.0)[0] == "said\n"
    assert ended.returncode == status


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_client_passes_signals_on(
    client: Callable[[str], subprocess.Popen[str]], number: signal.Signals
) -> None:
    code = (
        "import os, signal, sys, time\n"
        f"signal.signal({int(number)}, lambda number, frame: sys.exit(7))\n"
        "print(os.getpid(), flush=True)\n"
        "time.sleep(1000)"
    )
    running = client(code)
    assert running.stdout is not None
    running.stdout.readline()
    running.send_signal(number)
    assert running.wait(30.0) == 7


def test_a_client_dies_of_the_signal_that_its_node_died_of(
    client: Callable[[str], subprocess.Popen[str]],
) -> None:
    running = client(FOREVER)
    assert running.stdout is not None
    os.kill(int(running.stdout.readline()), signal.SIGKILL)
    assert running.wait(30.0) == -signal.SIGKILL


def test_a_node_dies_with_its_client(client: Callable[[str], subprocess.Popen[str]]) -> None:
    running = client(FOREVER)
    assert running.stdout is not None
    pid = int(running.stdout.readline())
    running.kill()
    until(lambda: not lives(pid))
    again = client("print('the server goes on')")
    assert again.communicate(timeout=30.0)[0] == "the server goes on\n"


def test_without_a_server_a_client_becomes_the_node(
    client: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    node = tmp_path / "lib" / "node"
    node.parent.mkdir()
    node.write_text("#!/bin/sh\necho by itself: $1\nexit 5\n")
    node.chmod(0o755)
    alone = client("words", address="flock-fork-server-of-nobody")
    assert alone.communicate(timeout=30.0)[0] == "by itself: words\n"
    assert alone.returncode == 5


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")
def test_a_server_does_not_serve_other_users(tmp_path: Path) -> None:
    server = ForkServer.spawn("os:getpid", listen=True)
    code = (
        "import os, socket, sys\n"
        "os.setuid(65534)\n"
        "with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:\n"
        "    connection.connect(chr(0) + sys.argv[1])\n"
        "    try:\n"
        "        print(connection.recv(100))\n"
        "    except ConnectionError:\n"
        "        print(b'')\n"
    )
    command = [sys.executable, "-c", code, server.address]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    assert (done.stdout, done.stderr) == ("b''\n", "")
    server.close()

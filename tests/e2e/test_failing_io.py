# SPDX-License-Identifier: Apache-2.0
"""Any I/O call on the files of a bag may fail: no state is lost, and the flight can be flown on.

A tool is run again and again, and each time another of its calls fails. It must end with one line
that names the file and the reason. Then the bag has the first states of the flight, bit for bit,
and a second run makes it equal to the reference. FLOCK_IO_FAULTS=N lets N calls of each tool fail
in each way, instead of a few; with a large N all of them.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from flock_sim.bag.directory import DAMAGED
from flock_sim.bag.writing.partial_bag import recorded_in
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.launcher.fork_server import ForkServer
from flock_sim.recording.run import Run
from support.bags import assert_begins_as, assert_equal
from support.failing_io import ERRORS, SHORT, Call, FailingIO, Fault, failing_server
from support.flights import record
from support.terminal import Done, Terminal

COUNT = int(os.environ.get("FLOCK_IO_FAULTS", "0"))
"""Calls that fail in each way; 0: a few."""

FLOCK = ("--birds", 3, "--t-max", 2000, "--record-every", 10)
STATES = 3 * 201

LONG = FlockConfiguration(birds=3, t_max=30_000.0, record_every=10)
"""A flight whose bag has several chunks."""

every_error = pytest.mark.parametrize(
    "how",
    [pytest.param(how, marks=[] if how == "one call" else pytest.mark.slow) for how in ERRORS],
)

Trial = Callable[[Fault, int], list[Call]]
"""Lets a call fail, and checks what follows. Returns the calls of the tool."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ForkServer]:
    """A server of tools whose calls can fail."""
    with failing_server(tmp_path_factory.mktemp("failing-io")) as opened:
        yield opened


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference of FLOCK."""
    configuration = FlockConfiguration(birds=3, t_max=2000.0, record_every=10)
    return record(tmp_path_factory.mktemp("reference") / "bag", configuration)


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of LONG, damaged in its middle."""
    torn = record(tmp_path_factory.mktemp("damaged") / "bag", LONG)
    spoil(torn, "damaged")
    return torn


def let_fail(how: str, few: int, trial: Trial) -> None:
    """Call `trial` with no failing call, and then with `few` of those that can fail, or COUNT."""
    fault = ERRORS[how]
    calls = trial(fault, 0)
    numbers = [call.number for call in calls if call.can or fault.instead]
    wrong = []
    for number in spread(numbers, COUNT or few):
        try:
            trial(fault, number)
        except AssertionError as error:
            wrong.append(f"call {number}, {calls[number - 1]}:\n{error}")
    if wrong:
        pytest.fail("\n\n".join(wrong), pytrace=False)


def spread(numbers: Sequence[int], count: int) -> list[int]:
    """Return `count` of `numbers`, the first and the last among them; all if they are fewer."""
    count = min(count, len(numbers))
    return [numbers[k * (len(numbers) - 1) // max(count - 1, 1)] for k in range(count)]


def assert_told(done: Done, calls: Sequence[Call], path: Path) -> None:
    """Assert that a tool has failed only by its calls, and tells file and reason in one line."""
    if "Traceback" in done.stderr:
        raise AssertionError(done.stderr)
    reasons = {os.strerror(call.error) for call in calls if call.error > 0}
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    if done.status == 0:
        assert not errors
        return
    assert reasons, done.stderr
    assert done.status in (1, 2), done.stderr
    assert done.stdout == ""
    first, *others = errors
    assert len(others) < 2, done.stderr
    assert all(re.fullmatch("error: the recorder ended with status [12]", one) for one in others)
    assert any(reason in first for reason in reasons), done.stderr
    assert str(path) in first, done.stderr


def assert_safe(done: Done, bag: Path, reference: Path) -> int:
    """Assert that a bag has the first states of the reference, and all that the tool calls safe.

    Returns the number of states.
    """
    try:
        if recorded_in(bag) is None:
            return 0
        with Run(bag) as run:
            messages = len(list(run.bag.salvage([])))
    except FlockError:
        messages = states = 0
    else:
        states = assert_begins_as(bag, reference)
    told = re.search(r"(\d+) messages (recorded before )?are safe", done.stderr)
    assert messages >= (int(told[1]) if told else 0), done.stderr
    return states


@dataclass
class Flights:
    """The flights of a test, and the tools whose calls fail."""

    terminal: Terminal
    disk: FailingIO
    bag: Path
    """The bag that a failing tool writes; calls fail on files of its parent directory."""
    reference: Path

    def run(
        self, fault: Fault, first: int, tool: str, *arguments: object
    ) -> tuple[Done, list[Call]]:
        """Run a tool whose calls fail from `first` on, and check its exit status and its line."""
        done, calls = self.disk.run(tool, *arguments, fault=fault, first=first)
        assert_told(done, calls, self.bag.parent)
        return done, calls

    def put(self, bag: Path) -> None:
        """Replace the bag by a copy of another one."""
        self.remove()
        shutil.copytree(bag, self.bag)

    def remove(self) -> None:
        shutil.rmtree(self.bag, ignore_errors=True)

    def assert_equal(self) -> None:
        """Assert that the bag is complete and equals the reference bit for bit."""
        assert_equal(self.terminal, str(self.bag), str(self.reference), STATES)
        files = {entry.name for entry in self.bag.iterdir() if DAMAGED not in entry.name}
        assert files == {f"{self.bag.name}_0.mcap", "metadata.yaml"}

    def assert_flown_on(self, states: int) -> None:
        """Assert that the flight, of which `states` are on disk, can be resumed or flown again."""
        done = self.terminal.run("fly", "--resume", self.bag)
        if done.status == 2 and not states:
            assert "nothing to continue" in done.error or "there is no bag" in done.error
            self.fly_again()
        else:
            assert done.status == 0, done.stderr
            self.assert_equal()

    def assert_equal_or_fly_again(self, done: Done) -> None:
        """Assert that a flight without an error is whole, and that another can be flown again."""
        if done.status == 0:
            self.assert_equal()
        else:
            self.fly_again()

    def fly_again(self) -> None:
        """Assert that the flight can be flown again in the same directory."""
        force = ["--force"] if self.bag.exists() else []
        self.terminal.well("reference", *FLOCK, "--output", self.bag, *force)
        self.assert_equal()


@pytest.fixture
def flights(terminal: Terminal, server: ForkServer, reference: Path) -> Flights:
    bags = terminal.directory / "bags"
    bags.mkdir()
    return Flights(terminal, FailingIO(terminal, server, bags), bags / "bag", reference)


@pytest.mark.parametrize("tool", [pytest.param("fly", marks=pytest.mark.slow), "reference"])
def test_short_writes_change_nothing(flights: Flights, tool: str) -> None:
    fault = Fault(SHORT, lasting=True)
    done, calls = flights.run(fault, 1, tool, *FLOCK, "--output", flights.bag)
    assert done.status == 0
    assert sum(call.error == SHORT for call in calls) > 20
    flights.assert_equal()


@every_error
def test_a_flight_goes_on_after_any_failing_call(flights: Flights, how: str) -> None:
    def trial(fault: Fault, first: int) -> list[Call]:
        flights.remove()
        done, calls = flights.run(fault, first, "fly", *FLOCK, "--output", flights.bag)
        states = assert_safe(done, flights.bag, flights.reference)
        if done.status == 0:
            flights.assert_equal()
        else:
            flights.assert_flown_on(states)
        return calls

    let_fail(how, 2, trial)


@pytest.mark.slow
@every_error
@pytest.mark.parametrize("damage", ["cut", "damaged"])
def test_a_resumed_flight_goes_on_after_any_failing_call(
    flights: Flights, damage: str, how: str
) -> None:
    torn = flights.terminal.directory / "torn" / "bag"
    flights.terminal.well("fly", *FLOCK, "--output", torn)
    spoil(torn, damage)
    before = (torn / "bag_0.mcap").read_bytes()

    def trial(fault: Fault, first: int) -> list[Call]:
        flights.put(torn)
        done, calls = flights.run(fault, first, "fly", "--resume", flights.bag)
        if damage == "cut":
            # A chunk whose message indexes are cut off is not kept: its rows are flown again.
            assert_safe(done, flights.bag, flights.reference)
        else:
            assert any(entry.read_bytes() == before for entry in flights.bag.iterdir())
        flights.assert_flown_on(STATES)
        return calls

    let_fail(how, 1, trial)


def spoil(bag: Path, damage: str) -> None:
    """Cut the end of a bag off, or damage its middle."""
    (bag / "metadata.yaml").unlink()
    file = bag / f"{bag.name}_0.mcap"
    size = file.stat().st_size
    with file.open("r+b") as opened:
        if damage == "cut":
            opened.truncate(size * 3 // 5)
        else:
            opened.seek(size * 2 // 5)
            opened.write(bytes(16))


@every_error
def test_a_reference_flight_is_flown_again_after_any_failing_call(
    flights: Flights, how: str
) -> None:
    def trial(fault: Fault, first: int) -> list[Call]:
        flights.remove()
        done, calls = flights.run(fault, first, "reference", *FLOCK, "--output", flights.bag)
        assert_safe(done, flights.bag, flights.reference)
        flights.assert_equal_or_fly_again(done)
        return calls

    let_fail(how, 4, trial)


@pytest.mark.slow
@every_error
@pytest.mark.parametrize("tool", ["reference", "fly"])
def test_a_replaced_bag_or_the_new_one_is_there_after_any_failing_call(
    flights: Flights, tool: str, how: str
) -> None:
    old = flights.terminal.directory / "old" / "bag"
    flights.terminal.well("reference", "--birds", 2, "--t-max", 500, "--output", old)

    def trial(fault: Fault, first: int) -> list[Call]:
        flights.put(old)
        done, calls = flights.run(fault, first, tool, *FLOCK, "--output", flights.bag, "--force")
        with Run(flights.bag) as run:
            old_is_there = run.configuration.birds == 2
        if old_is_there:
            assert done.status != 0
            assert assert_begins_as(flights.bag, old) == 2 * 51
        else:
            assert assert_safe(done, flights.bag, flights.reference) > 0
        flights.assert_equal_or_fly_again(done)
        return calls

    let_fail(how, 3 if tool == "reference" else 1, trial)


@every_error
@pytest.mark.parametrize("place", ["beside", "in place"])
def test_a_damaged_bag_is_repaired_after_any_failing_call(
    flights: Flights, damaged: Path, place: str, how: str
) -> None:
    source = flights.bag if place == "in place" else flights.bag.with_name("source")
    repaired = flights.terminal.directory / "repaired" / "bag"
    flights.terminal.well("repair", damaged, "--output", repaired)
    whole = intact(repaired)

    def trial(fault: Fault, first: int) -> list[Call]:
        flights.remove()
        shutil.copytree(damaged, source, dirs_exist_ok=True)
        repair = ("repair", source, "--output", flights.bag)
        force = ["--force"] if place == "in place" else []
        _, calls = flights.run(fault, first, *repair, *force)
        if place == "in place":
            assert intact(source) == whole
        else:
            assert content(source) == content(damaged)
            if is_complete(flights.bag):
                assert intact(flights.bag) == whole
        flights.terminal.well(*repair, *(["--force"] if flights.bag.exists() else []))
        assert intact(flights.bag) == whole
        return calls

    let_fail(how, 4, trial)


def is_complete(bag: Path) -> bool:
    """Whether a bag is there, and nothing in it is missing."""
    if not bag.exists() or recorded_in(bag) is None:
        return False
    try:
        with Run(bag) as run:
            return run.missing is None
    except FlockError:  # not even its first bytes could be written, and it could not be removed
        return False


def intact(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return the messages of the sound chunks of a bag."""
    with Run(bag) as run:
        return list(run.bag.salvage([]))


def content(directory: Path) -> dict[str, bytes]:
    """Return the content of each file, by its name."""
    return {entry.name: entry.read_bytes() for entry in sorted(directory.iterdir())}

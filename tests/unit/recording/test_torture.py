# SPDX-License-Identifier: Apache-2.0
"""Bags under random attacks at random moments and places: each ends whole, or is refused.

FLOCK_TORTURE=1 tries many more.
"""

from __future__ import annotations

import argparse
import os
import shutil
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from random import Random

import pytest

from flock_sim.bag.writing.writer import BagWriter
from flock_sim.commands import fly, reference
from flock_sim.commands.resume import EXCLUDED, resumable
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.console.arguments import run_tool
from flock_sim.errors import FlockError, RunFailed
from flock_sim.messages.handshake import handshake
from flock_sim.messages.types import Grant
from flock_sim.recording.flight_writer import Recording, lay_down, recording
from flock_sim.recording.output_directory import own_output
from flock_sim.recording.run import Run
from flock_tools.commands import repair
from support.flights import flown_rows, record

TRIES = 250 if os.environ.get("FLOCK_TORTURE") else 12
FLOWN = FlockConfiguration(birds=3, t_max=100.0, record_every=2)
OTHER = FlockConfiguration(birds=2, t_max=20.0)
ROWS = flown_rows(FLOWN)
WHOLE = [data for row in ROWS for data in row.states]
GRANT = Grant(7, 60, 100, 1.0, 1, handshake(FLOWN)).encode()


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BagWriter.__init__.__kwdefaults__, "chunk_size", 4096)


def fly_on(run: Recording, to: int = 1000) -> None:
    """Record the rows that are left, up to a step."""
    for row in ROWS:
        if run.saved < row.step <= to:
            if row.step % 20 == 0:
                run.write_grant(GRANT)
            run.write_row(row)
            if row.step % 14 == 0:
                run.flush()
    run.flush()


def assert_whole(bag: Path) -> None:
    """The bag is complete and equals the reference, each state once."""
    with Run(bag) as run:
        assert run.missing is None
        broken: list[str] = []
        states = {f"/flock/bird_{bird:02d}/state" for bird in (1, 2, 3)}
        found = [data for topic, _, data in run.bag.salvage(broken) if topic in states]
    assert broken == []
    assert found == WHOLE


def resume(bag: Path) -> None:
    """Do as `fly --resume`. Raises FlockError as that does."""
    with resumable(bag, argparse.Namespace(**dict.fromkeys([*EXCLUDED, "law"]))) as found:
        if not found.complete:
            with recording(bag, FLOWN, grants=True, resume=True) as run:
                fly_on(run)


def one_line(error: FlockError) -> str:
    """Return what a user is told, which is one line."""
    assert "\n" not in str(error)
    return str(error)


def tell(counts: Counter[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Say in `make torture` what was tried, and how it ended."""
    if TRIES > 100:
        with capsys.disabled():
            print(f"\n{TRIES} tries:", ", ".join(f"{n} {what}" for what, n in counts.items()))


def contents(bag: Path) -> dict[str, bytes]:
    return {entry.name: entry.read_bytes() for entry in bag.iterdir()}


def repaired(bag: Path, output: Path) -> list[int] | None:
    """Repair a bag; return the steps that are missing, None where there is nothing to repair.

    Raises FlockError as `repair` does.
    """
    with Run(bag) as hurt:
        damage = repair.examine(hurt)
        if not damage.any:
            return None
        repair.rewrite(hurt, output)
        return damage.missing_steps


def assert_kept(bag: Path, missing: list[int]) -> None:
    """What is in a repaired bag was flown, and none of it is said to be missing."""
    with Run(bag) as run:
        found = [state.encode() for _, state in run.states()]
    assert set(found) <= set(WHOLE)
    assert {WHOLE.index(data) // 3 * 2 for data in found}.isdisjoint(missing)


def files(directory: Path) -> list[bytes]:
    return [entry.read_bytes() for entry in directory.iterdir() if entry.is_file()]


class Attack:
    """One try to take a bag that is recorded to, or to spoil it."""

    POLITE = ("reference", "fly", "resume", "repair")
    """Our own tools: they are to be refused."""
    RUDE = ("unlink", "move", "move all", "remove all", "truncate", "overwrite", "replace")
    """What other programs do: it is to be noticed."""

    def __init__(self, bag: Path, chance: Random) -> None:
        self._bag = bag
        self._chance = chance
        self.kind = chance.choice((*self.POLITE, *self.RUDE))
        self.polite = self.kind in self.POLITE

    def __call__(self) -> None:
        """Do it; a tool must be refused, and change nothing."""
        bag, file = self._bag, self._bag / "bag_0.mcap"
        flock = ["--birds", "2", "--t-max", "20", "--output", str(bag), "--force"]
        if self.polite:
            torn = bag.parent / "torn"
            before = files(bag)
            tool, words = {
                "reference": (reference.tool, flock),
                "fly": (fly.tool, flock),
                "resume": (fly.tool, ["--resume", str(bag)]),
                "repair": (repair.tool, [str(torn), "--output", str(bag), "--force"]),
            }[self.kind]
            assert run_tool(tool, words) == 2
            assert files(bag) == before
        elif self.kind == "unlink":
            file.unlink()
        elif self.kind == "move":
            file.rename(bag.parent / "elsewhere.mcap")
        elif self.kind == "move all":
            bag.rename(bag.parent / "elsewhere")
        elif self.kind == "remove all":
            shutil.rmtree(bag)
        elif self.kind == "truncate":
            os.truncate(file, self._chance.randrange(file.stat().st_size))
        elif self.kind == "overwrite":
            size = self._chance.randint(1, 200)
            with file.open("r+b") as opened:
                at = self._chance.randrange(file.stat().st_size - size)
                opened.seek(at)
                old = opened.read(size)
                opened.seek(at)
                opened.write(bytes(byte ^ self._chance.randint(1, 255) for byte in old))
        else:
            shutil.rmtree(bag)
            shutil.copytree(bag.parent / "other", bag)
            (bag / "other_0.mcap").rename(file)


def recorded(bag: Path, old: bool, moment: int, attack: Attack) -> RunFailed | None:
    """Record a flight that is attacked at step `moment`; return how it failed, if it did."""
    try:
        with ExitStack() as owned:
            output = owned.enter_context(own_output(bag, force=old))
            run = owned.enter_context(recording(bag, FLOWN, grants=True, replace=output.replaces))
            fly_on(run, moment)
            attack()
            fly_on(run)
    except RunFailed as error:
        return error
    return None


def test_a_bag_that_is_recorded_to_is_whole_at_the_end_or_the_flight_fails(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chance = Random(16)
    seen: Counter[str] = Counter()
    record(tmp_path / "other", OTHER)
    (record(tmp_path / "torn", OTHER) / "metadata.yaml").unlink()
    kept = [tmp_path / "other", tmp_path / "torn"]
    for _ in range(TRIES):
        bag = tmp_path / "bag"
        old = chance.random() < 0.5
        if old:
            shutil.copytree(tmp_path / "other", bag)
        attack = Attack(bag, chance)
        # To spoil an old bag, before the new one has begun, is no attack on that.
        moment = chance.randrange(-1 if attack.polite else 0, 90)
        failed = recorded(bag, old, moment, attack)
        if attack.polite:
            assert failed is None
            assert_whole(bag)
        else:
            assert failed is not None, attack.kind
            assert "bag_0.mcap failed: " in one_line(failed)
            # Nothing says of what is there now that it was flown.
            if attack.kind == "replace":
                assert sorted(files(bag)) == sorted(files(tmp_path / "other"))
            else:
                assert not (bag / "metadata.yaml").exists()
        seen[attack.kind] += 1
        for entry in tmp_path.iterdir():
            if entry not in kept:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    tell(seen, capsys)
    assert TRIES < 100 or len(seen) == len(Attack.POLITE + Attack.RUDE)


def spoil(path: Path, head: int, chance: Random) -> None:
    """Damage a file: bits, holes, its end, or several of them; rarely its first `head` bytes."""
    data = bytearray(path.read_bytes())
    for _ in range(chance.randint(1, 3)):
        at = chance.randrange(0 if chance.random() < 0.05 else min(head, len(data) - 1), len(data))
        kind = chance.choice(("bit", "bit", "zeros", "noise", "cut", "insert"))
        if kind == "bit":
            data[at] ^= 1 << chance.randrange(8)
        elif kind == "zeros":
            size = min(chance.randint(1, 9000), len(data) - at)
            data[at : at + size] = bytes(size)
        elif kind == "noise":
            size = min(chance.randint(1, 300), len(data) - at)
            data[at : at + size] = chance.randbytes(size)
        elif kind == "insert":
            data[at:at] = chance.randbytes(chance.randint(1, 300))
        elif len(data) > 100:
            del data[max(at, 100) :]
    path.write_bytes(data)


def test_a_bag_damaged_anywhere_is_flown_to_its_end_or_refused_and_left_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chance = Random(6)
    outcomes: Counter[str] = Counter()
    lay_down(tmp_path / "head", FLOWN, grants=True, stages=False)
    head = (tmp_path / "head" / "head_0.mcap").stat().st_size
    for _ in range(TRIES):
        bag, path = tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"
        with recording(bag, FLOWN, grants=True) as run:
            fly_on(run, chance.choice((0, 40, 1000, 1000)))
        spoil(path, head, chance)
        if chance.random() < 0.3:
            (bag / "metadata.yaml").unlink()
        before = contents(bag)
        output = tmp_path / "repaired"
        try:
            missing = repaired(bag, output)
        except FlockError as error:
            outcomes["not repaired"] += bool(one_line(error))
            missing = None
        assert contents(bag) == before
        if missing is not None:
            assert_kept(output, missing)
            resume(output)
            assert_whole(output)
            outcomes["repaired"] += 1
        try:
            resume(bag)
        except FlockError as error:
            outcomes["refused"] += bool(one_line(error))
            assert contents(bag) == before
        else:
            assert_whole(bag)
            aside = bag / "bag_0.mcap.damaged"
            outcomes["put aside"] += aside.exists()
            assert not aside.exists() or aside.read_bytes() == before["bag_0.mcap"]
            outcomes["flown"] += 1
        shutil.rmtree(bag)
        shutil.rmtree(output, ignore_errors=True)
    tell(outcomes, capsys)
    assert outcomes["flown"] > TRIES // 2
    assert outcomes["put aside"] > 0

# SPDX-License-Identifier: Apache-2.0
"""What a report shows of a run, as plain numbers: few enough for one file, and true to the bag."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flock_sim.core import chain
from flock_sim.core.configuration import FlockConfiguration
from flock_sim.core.flock import Flock
from flock_sim.core.kernel import FloatArray
from flock_sim.core.metrics import Metrics
from flock_sim.core.scaling import Scales
from flock_sim.errors import RunFailed
from flock_sim.recording import CONFIGURATION_RECORD
from flock_sim.run import Run
from flock_tools.dataset import read
from flock_tools.decimation import bucket_width, ends, extremes, frame_rows
from flock_tools.equilibrium import Assessment

MOST_NUMBERS = 750_000
"""Numbers of all histories in a report: 4 MB as they are written."""

MOST_BUCKETS = 800
"""Buckets of a curve: one for each pixel that a page gives it, at most."""

FEWEST_BUCKETS = 40
"""Buckets below which rather fewer members are shown."""

FRAMES = 0.4
"""Moments of the formation that are kept, for each bucket of a curve."""

PART = 4_000_000
"""Numbers of a bag that are held at once, or one bucket of them."""


@dataclass(frozen=True)
class Room:
    """How much of every run there is room for in one file."""

    buckets: int
    members: list[int]
    """Of each run: how many of its members are shown."""

    @classmethod
    def of(cls, configurations: Sequence[FlockConfiguration]) -> Room:
        """Return the room that there is for runs of these configurations."""
        # A bucket has two values of three quantities, a frame one value of two.
        each = [(6.0 + 2.0 * FRAMES) * flown.birds for flown in configurations]
        members = [flown.members for flown in configurations]

        def buckets() -> int:
            return int(MOST_NUMBERS / sum(a * b for a, b in zip(each, members, strict=True)))

        while buckets() < FEWEST_BUCKETS and max(members) > 1:
            most = max(members)
            members[members.index(most)] = most - -(-most // 10)
        return cls(min(max(buckets(), 4), MOST_BUCKETS), members)


@dataclass(frozen=True)
class History:
    """The way of a flock through time; arrays end with dims (series, members).

    Curves have `len(time)` rows: all there are, or the extremes of buckets of `width` rows.
    """

    rows: int
    width: int
    time: FloatArray
    """Shape (points,), in b / U_min."""
    speed: FloatArray
    """U_i, shape (points, birds, members), in U_min."""
    spacing: FloatArray
    """x_{i+1} - x_i, shape (points, birds - 1, members), in b."""
    drag_reduction: FloatArray
    """eta_i, shape (points, birds, members)."""
    speed_std: FloatArray
    """sigma_U, shape (points, 1, members), in U_min."""
    mean_drag_reduction: FloatArray
    """eta, shape (points, 1, members)."""
    frame_time: FloatArray
    """Shape (frames,), in b / U_min."""
    frame_position: FloatArray
    """x_i from the leader, shape (frames, birds, members), in b.

    From the first bird that has a position where the leader has none.
    """
    frame_drag_reduction: FloatArray
    """eta_i, shape (frames, birds, members)."""


@dataclass(frozen=True)
class Theory:
    """What is known of a flock without flying it."""

    assessment: Assessment | None
    """The steady state and its eigenvalues; None where none was found."""
    note: str
    """Why there is none; else what it leaves aside; else empty."""
    linear: FloatArray
    """The spacings of the linear law, shape (birds - 1, members), in b; nan where it is none."""


@dataclass(frozen=True)
class Reported:
    """All that is shown of a run."""

    name: str
    configuration: FlockConfiguration
    factor: float
    """How much faster than real time it was flown freely; 0: in lockstep."""
    missing: str | None
    metrics: Metrics
    history: History
    theory: Theory
    pushes: list[str]
    """The perturbations that were asked for in flight."""
    flock_version: str
    files: list[tuple[str, int, str]]
    """Name, size in bytes and SHA-256 of each file of the recording."""


def reported(run: Run, room: Room, members: int, show: Callable[[float], None]) -> Reported:
    """Return what is shown of `run` and `members` of its members; `show` takes the rows read.

    Raises FlockError where the bag holds no complete step, or is damaged.
    """
    metrics = run.metrics()
    record = run.bag.metadata(CONFIGURATION_RECORD)
    return Reported(
        name=str(run.path),
        configuration=run.configuration,
        factor=run.real_time_factor,
        missing=run.missing,
        metrics=metrics,
        history=history(run, metrics.steps, members, room.buckets, show),
        theory=theory(run.configuration, metrics),
        pushes=[str(push) for push in run.perturbations()],
        flock_version=str(json.loads(record.get("flock_version", '"not recorded"'))),
        files=[_file(path) for path in _recordings(run.path)],
    )


def history(
    run: Run, last: int, members: int, buckets: int, show: Callable[[float], None]
) -> History:
    """Return the way of the first `members` flocks to step `last`, in so many buckets.

    The bag is read once, part by part.
    """
    configuration = run.configuration
    rows = last // configuration.record_every + 1
    width = bucket_width(rows, buckets)
    frames = frame_rows(rows, max(2, int(FRAMES * buckets)))
    times: list[FloatArray] = []
    curves: list[list[FloatArray]] = []
    moments: list[list[FloatArray]] = []
    for first, end in _parts(configuration, rows, width):
        begin, until = (
            configuration.time(row * configuration.record_every) for row in (first, end - 1)
        )
        data = read(run, begin, until).isel(member=slice(members))
        dims = ("time", "bird", "member")
        position, speed, drag = (
            data[name].transpose(*dims).to_numpy()
            for name in ("position", "speed", "interaction_drag")
        )
        with np.errstate(invalid="ignore", over="ignore"):
            reduction = (0.0 - drag) / Scales.of(configuration).cruise_drag
            series = [
                speed,
                np.diff(position, axis=1),
                reduction,
                speed.std(axis=1, keepdims=True),
                reduction.mean(axis=1, keepdims=True),
            ]
            relative = position - _origin(position, int(data.attrs["leader"]) - 1)
        times.append(data.time.to_numpy())
        curves.append([extremes(values, width) for values in series])
        here = frames[(frames >= first) & (frames < end)] - first
        moments.append([times[-1][here], relative[here], reduction[here]])
        show(end - first)
    return History(
        rows,
        width,
        ends(np.concatenate(times), width),
        *(np.concatenate(parts) for parts in zip(*curves, strict=True)),
        *(np.concatenate(parts) for parts in zip(*moments, strict=True)),
    )


def _origin(position: FloatArray, leader: int) -> FloatArray:
    """Return where positions are told from: of shape (rows, birds, members), (rows, 1, members).

    That is the bird with the index `leader` or, where that has none, the first that has a position.
    """
    first = np.isfinite(position).argmax(axis=1, keepdims=True)
    led = position[:, leader : leader + 1]
    return np.where(np.isfinite(led), led, np.take_along_axis(position, first, axis=1))


def _parts(configuration: FlockConfiguration, rows: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield (first, end) of the rows that are read at once: whole buckets, but for the last."""
    bucket = 4 * width * configuration.birds * configuration.members
    part = width * max(1, PART // bucket)
    for first in range(0, rows, part):
        yield first, min(first + part, rows)


def theory(configuration: FlockConfiguration, metrics: Metrics) -> Theory:
    """Return the steady states of the members of a flock, and the linear law where it applies."""
    flock = Flock.of(configuration)
    linear = np.full((flock.birds - 1, flock.members), np.nan)
    applies = [error is not None for error in metrics.profile_error]
    if any(applies):
        share = np.empty_like(linear)
        share[:] = (1.0 - np.arange(1, flock.birds) / flock.birds)[:, np.newaxis]
        chain.fill_spacings(flock.span_ratio, share, linear)
        linear[:, ~np.array(applies)] = np.nan
    try:
        assessment = Assessment.of(configuration)
    except RunFailed as error:
        return Theory(None, str(error), linear)
    note = ""
    if not configuration.linkage.plain:
        note = "Theory is that of birds that know their neighbours exactly: not of these links."
    return Theory(assessment, note, linear)


def _recordings(path: Path) -> list[Path]:
    return sorted(path.glob("*.mcap")) if path.is_dir() else [path]


def _file(path: Path) -> tuple[str, int, str]:
    with path.open("rb") as file:
        return path.name, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()

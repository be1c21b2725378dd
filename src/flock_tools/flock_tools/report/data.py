# SPDX-License-Identifier: Apache-2.0
"""The data of a run in a report: plain numbers, few enough for one file, with all extremes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flock_sim.analysis.metrics import Metrics
from flock_sim.analysis.time_means import TimeMeans
from flock_sim.analysis.verdict import Verdicts
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import RunFailed
from flock_sim.outside import json_text
from flock_sim.outside.regular_file import open_file
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.scaling import Scales, drag_reduction
from flock_sim.recording.flight_bag import CONFIGURATION_RECORD
from flock_sim.recording.own_parts import BIRD, OwnPart, names
from flock_sim.recording.run import Run
from flock_sim.theory import nearest
from flock_tools.report.decimation import bucket_width, ends, extremes, frame_rows
from flock_tools.runs.assessment import Assessment
from flock_tools.runs.dataset import read

MOST_NUMBERS = 500_000
"""Largest count of numbers in all histories of a report: 2.7 MB in the file."""

MOST_BUCKETS = 2000
"""Largest number of buckets of a curve: several for each pixel, as a part can be enlarged."""

FEWEST_BUCKETS = 40
"""Number of buckets below which fewer members are shown instead."""

FRAMES = 0.4
"""Largest number of frames of the formation per bucket of a curve."""

MOST_FRAMES = 320
"""Largest number of frames of the formation: 16 s of motion."""

SPREAD = 3
"""Index of sigma_U among the curves."""

ROUNDING = 1e-12
"""Spread of the equal speeds of a start, in U_min, below which it is rounding."""

PART = 4_000_000
"""Largest count of numbers of a bag in memory at once, unless one bucket has more."""


@dataclass(frozen=True)
class Room:
    """The numbers of buckets and members that fit in one file."""

    buckets: int
    members: list[int]
    """For each run: the number of members that are shown."""

    @classmethod
    def of(cls, configurations: Sequence[FlockConfiguration]) -> Room:
        """Return the room for runs of these configurations."""
        # A bucket has two values of three quantities, a frame one value of four.
        each = [(6.0 + 4.0 * FRAMES) * flown.birds for flown in configurations]
        members = [flown.members for flown in configurations]

        def buckets() -> int:
            return int(MOST_NUMBERS / sum(a * b for a, b in zip(each, members, strict=True)))

        while buckets() < FEWEST_BUCKETS and max(members) > 1:
            most = max(members)
            members[members.index(most)] = most - -(-most // 10)
        return cls(min(max(buckets(), 4), MOST_BUCKETS), members)


@dataclass(frozen=True)
class History:
    """The history of a flock. Arrays end with dims (series, members).

    Curves have `len(time)` rows: all recorded rows, or the extremes of buckets of `width` rows.
    """

    rows: int
    width: int
    time: FloatArray
    """Time of each point, shape (points,), in b / U_min."""
    speed: FloatArray
    """U_i, shape (points, birds, members), in U_min."""
    spacing: FloatArray
    """x_{i+1} - x_i, shape (points, birds - 1, members), in b."""
    drag_reduction: FloatArray
    """eta_i, shape (points, birds, members)."""
    speed_std: FloatArray
    """sigma_U, shape (points, 1, members), in U_min; nan where it is the rounding of the start."""
    mean_drag_reduction: FloatArray
    """eta, shape (points, 1, members)."""
    frame_time: FloatArray
    """Time of each frame, shape (frames,), in b / U_min."""
    frame_position: FloatArray
    """x_i from the leader, shape (frames, birds, members), in b.

    If the leader has no position, from the first bird that has one.
    """
    frame_speed: FloatArray
    """The values of `speed`, `spacing` and so on at the time of each frame, in their shapes."""
    frame_spacing: FloatArray
    frame_drag_reduction: FloatArray
    frame_speed_std: FloatArray
    frame_mean_drag_reduction: FloatArray


@dataclass(frozen=True)
class Theory:
    """The theoretical results for a flock."""

    assessment: Assessment | None
    """The steady state and its eigenvalues; None if none was found."""
    note: str
    """The reason why there is none, or a limitation of the assessment, or empty."""
    linear: FloatArray
    """The spacings of the linear law, shape (birds - 1, members), in b; nan if it has none."""


@dataclass(frozen=True)
class Reported:
    """All data of a run in a report."""

    name: str
    configuration: FlockConfiguration
    factor: float
    """Real-time factor of a free flight; 0: in lockstep."""
    missing: str | None
    metrics: Metrics
    means: TimeMeans
    """Means over the last tenth of the flight."""
    verdicts: Verdicts
    history: History
    theory: Theory
    pushes: list[str]
    """The perturbations that were requested in flight."""
    own_parts: list[OwnPart]
    """The parts of the flight that are not in Flock."""
    flock_version: str
    state_digest: str | None
    """The digest of all states; None for a bag without one."""
    machines: list[str]
    """The machines that recorded the flight, in words."""
    files: list[tuple[str, int, str]]
    """Name, size in bytes and SHA-256 of each file of the recording."""


def reported(run: Run, room: Room, members: int, show: Callable[[float], None]) -> Reported:
    """Return the data of `run` and of its first `members` members. `show` takes the rows read.

    Raises FlockError if the bag has no complete step, or is damaged.
    """
    metrics = run.metrics()
    record = run.bag.records.get(CONFIGURATION_RECORD, {})
    return Reported(
        name=str(run.path),
        configuration=run.configuration,
        factor=run.real_time_factor,
        missing=run.missing,
        metrics=metrics,
        means=run.time_means(metrics.t_final),
        verdicts=run.verdicts(),
        history=history(run, metrics.steps, members, room.buckets, show),
        theory=theory(run, metrics),
        pushes=[str(push) for push in run.perturbations()],
        own_parts=run.own_parts,
        flock_version=str(json_text.parse(record.get("flock_version", '"not recorded"'))),
        state_digest=run.state_digest,
        machines=[machine.told() for machine in run.machines],
        files=[_file(path) for path in _recordings(run.path)],
    )


def history(
    run: Run, last: int, members: int, buckets: int, show: Callable[[float], None]
) -> History:
    """Return the history of the first `members` flocks to step `last`, in `buckets` buckets.

    The bag is read once, part by part.
    """
    configuration = run.configuration
    rows = last // configuration.record_every + 1
    width = bucket_width(rows, buckets)
    frames = frame_rows(rows, max(2, min(int(FRAMES * buckets), MOST_FRAMES)))
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
            reduction = drag_reduction(drag, Scales.of(configuration).cruise_drag)
            series = [
                speed,
                np.diff(position, axis=1),
                reduction,
                speed.std(axis=1, keepdims=True),
                reduction.mean(axis=1, keepdims=True),
            ]
            relative = position - _origin(position, int(data.attrs["leader"]) - 1)
        times.append(data.time.to_numpy())
        here = frames[(frames >= first) & (frames < end)] - first
        moments.append([times[-1][here], relative[here], *(values[here] for values in series)])
        if first == 0:
            spread = series[SPREAD]
            spread[0][spread[0] < ROUNDING] = np.nan
        curves.append([extremes(values, width) for values in series])
        show(end - first)
    return History(
        rows,
        width,
        ends(np.concatenate(times), width),
        *(np.concatenate(parts) for parts in zip(*curves, strict=True)),
        *(np.concatenate(parts) for parts in zip(*moments, strict=True)),
    )


def _origin(position: FloatArray, leader: int) -> FloatArray:
    """Return the origin of positions (rows, birds, members), with shape (rows, 1, members).

    It is the position of the bird with index `leader` or, if that has none, of the first that has.
    """
    first = np.isfinite(position).argmax(axis=1, keepdims=True)
    led = position[:, leader : leader + 1]
    return np.where(np.isfinite(led), led, np.take_along_axis(position, first, axis=1))


def _parts(configuration: FlockConfiguration, rows: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield (first, end) of the rows read at once. All but the last have whole buckets."""
    bucket = 4 * width * configuration.birds * configuration.members
    part = width * max(1, PART // bucket)
    for first in range(0, rows, part):
        yield first, min(first + part, rows)


def theory(run: Run, metrics: Metrics) -> Theory:
    """Return the steady states of a flock's members, and the linear law if it applies."""
    configuration = run.configuration
    flock = Flock.of(configuration)
    linear = np.full((flock.birds - 1, flock.members), np.nan)
    applies = [error is not None for error in metrics.profile_error]
    if any(applies):
        share = np.empty_like(linear)
        share[:] = (1.0 - np.arange(1, flock.birds) / flock.birds)[:, np.newaxis]
        nearest.fill_spacings(flock.span_ratio, share, linear)
        linear[:, ~np.array(applies)] = np.nan
    try:
        assessment = Assessment.of(configuration)
    except RunFailed as error:
        return Theory(None, str(error), linear)
    note = ""
    if not configuration.link_table.plain:
        note = "The theory assumes links that are exact. The links of this run are not."
    if configuration.forcing:
        note = f"{note} The theory has no forces besides thrust and drag. This run has.".strip()
    if birds := names(run.own_parts, BIRD):
        note = f"{note} The theory assumes birds of Flock's. This run has birds of {birds}.".strip()
    return Theory(assessment, note, linear)


def _recordings(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    return sorted(file for file in path.glob("*.mcap") if file.is_file())


def _file(path: Path) -> tuple[str, int, str]:
    with open_file(path) as file:
        return path.name, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()

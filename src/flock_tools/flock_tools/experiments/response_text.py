# SPDX-License-Identifier: Apache-2.0
"""The response that `response` prints, as JSON and as text."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flock_sim.analysis.metrics import plain
from flock_sim.analysis.summary import MOST_MEMBERS
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.response.linear_response import Response, neighbour_pairs
from flock_sim.theory.sensitivity import Sensitivity

MOST_ROWS = 61
"""Largest number of birds whose table is printed."""

TIE = 1e-9
"""Largest relative difference of values that count as equal."""


def as_json(
    configuration: FlockConfiguration, found: Response, sensitivity: Sensitivity | None
) -> dict[str, Any]:
    """Return all results as plain values."""
    facts = {
        "birds": configuration.birds,
        "members": configuration.members,
        "coupling": configuration.coupling,
        **{name: value for name, value in vars(found).items() if name != "gust"},
    }
    if found.gust is not None:
        facts |= {name: value for name, value in vars(found.gust).items() if name != "std"}
        facts["gust"] = found.gust.std
    if sensitivity is not None:
        facts |= vars(sensitivity)
    return {name: plain(value) for name, value in facts.items()}


def described(
    configuration: FlockConfiguration,
    found: Response,
    sensitivity: Sensitivity | None,
    links: str,
) -> str:
    """Return the result as text; `links` says how birds know each other."""
    birds, members = configuration.birds, configuration.members
    flock = f"{birds} bird{'s' * (birds > 1)}, {configuration.coupling} coupling, {links}"
    lines = [flock + (f", {members} members" if members > 1 else "")]
    for m in range(min(members, MOST_MEMBERS)):
        lines += ["", f"member {m + 1}"] if members > 1 else []
        lines += _Member(configuration, found, sensitivity, m).lines()
    if members > MOST_MEMBERS:
        lines += ["", f"... and {members - MOST_MEMBERS} members more"]
    if members > 1:
        count = int(found.stable.sum())
        lines += ["", f"{count} of {members} members have a stable steady state"]
    return "\n".join(line.rstrip() for line in lines)


class _Member:
    """The text on one member."""

    def __init__(
        self,
        configuration: FlockConfiguration,
        found: Response,
        sensitivity: Sensitivity | None,
        m: int,
    ) -> None:
        self.birds = configuration.birds
        self.found, self.sensitivity, self.m = found, sensitivity, m
        self.length = 0.5 * configuration.wing_span  # b, in m
        self.unit = self.length / configuration.min_drag_speed  # b / U_min, in s
        self.metres = configuration.min_drag_speed

    def lines(self) -> list[str]:
        found, m = self.found, self.m
        if not found.exists[m]:
            return ["  no steady state: `./flock equilibrium` tells which birds part"]
        flies = f"U* = {found.speed[m]:.6f} U_min"
        if not found.stable[m]:
            return [f"  steady state         {flies}, unstable: disturbances grow, no response"]
        lines = [f"  steady state         {flies}, stable"]
        if self.birds > 1:
            lines += [*self._strings(), *self._gaps()]
        if found.gust is not None:
            lines += self._gust()
        if self.birds > MOST_ROWS:
            lines.append(f"  (--json lists all {self.birds} birds)")
        else:
            lines += self._table()
            if self.sensitivity is not None:
                lines += self._spans()
        return lines

    def _strings(self) -> list[str]:
        """Return the lines on how changes of the leader's speed pass along the wings."""
        found, m = self.found, self.m
        gains, speeds = found.neighbour_gain_peak[m], found.speed_gain_peak[m]
        if not np.isfinite(gains).all():
            return ["  string stability     none: behind a leader of given speed disturbances grow"]
        outer, inner = neighbour_pairs(self.birds)
        k, i = _largest(gains), _largest(speeds)
        if gains[k] <= 1.0:
            lines = [
                "  string stability     yes: no bird amplifies the speed changes of its neighbour",
                f"{'':23}that is nearer to the leader",
            ]
        else:
            lines = [
                f"  string stability     no: bird {outer[k] + 1} amplifies the speed changes of "
                f"bird {inner[k] + 1}, the most {gains[k]:.4g} times,",
                f"{'':23}{self._at(found.neighbour_gain_frequency[m, k])}",
            ]
        if speeds[i] <= 1.0:
            return [*lines, "  after the leader     no bird exceeds the changes of its speed"]
        return [
            *lines,
            f"  after the leader     bird {i + 1} changes its speed by the most, {speeds[i]:.4g} "
            "times the change",
            f"{'':23}of the leader's, {self._at(found.speed_gain_frequency[m, i])}",
        ]

    def _gaps(self) -> list[str]:
        found, m = self.found, self.m
        return [
            f"  H-infinity of gaps   {found.hinf_gaps[m]:.6g} b per U_min^2/b of acceleration of "
            "all birds,",
            f"{'':23}{self._at(found.hinf_gaps_frequency[m])}",
            f"    of the leader      {found.hinf_gaps_from_leader[m]:.6g}, "
            f"{self._at(found.hinf_gaps_from_leader_frequency[m])}",
        ]

    def _gust(self) -> list[str]:
        gust, m = self.found.gust, self.m
        assert gust is not None
        lines = [
            f"  gusts                dU = {gust.std:g} dW of every bird, independent and white"
        ]
        if self.birds > 1:
            worst = _largest(gust.gap_std[m])
            std = gust.gap_std[m, worst]
            lines.append(
                f"    worst gap          gap {worst + 1}, standard deviation {std:.4g} b "
                f"({100.0 * std * self.length:.3g} cm)"
            )
            if std > 0.5 * self._room(worst):
                lines += [
                    "    note               not small against distances over which drag changes:",
                    f"{'':23}the linear theory is a rough estimate",
                ]
        lines.append(
            f"    mean speed         standard deviation {gust.mean_speed_std[m]:.4g} U_min "
            f"({100.0 * gust.mean_speed_std[m] * self.metres:.3g} cm/s)"
        )
        if self.birds > 1:
            lines.append(
                f"    spread sigma_U     {gust.speed_spread_rms[m]:.4g} U_min (root mean square)"
            )
        return lines

    def _room(self, gap: int) -> float:
        """Return the distance over which the stiffness of a gap changes, in b."""
        return math.hypot(float(self.found.spacing[self.m, gap]), 2.0 + formation.TIP_SPACING)

    def _at(self, omega: float) -> str:
        if omega == 0.0:
            return "at omega = 0, that is, constant ones"
        period = 2.0 * math.pi / omega
        return f"at omega = {omega:.5g} (period {period:.4g}, {period * self.unit:.3g} s)"

    def _table(self) -> list[str]:
        """Return a row for each bird, with the gap to the next bird in the same row."""
        found, m, gust = self.found, self.m, self.found.gust
        columns: list[tuple[str, list[str]]] = [
            ("bird", [str(i + 1) for i in range(self.birds)]),
            ("over leader", _cells(found.speed_gain_peak[m], ".4f")),
            ("at omega", _cells(found.speed_gain_frequency[m], ".5f")),
        ]
        if gust is not None:
            columns.append(("speed std", _cells(gust.bird_speed_std[m], ".3e")))
        if self.birds > 1:
            columns += [
                ("gap", [f"{i + 1}-{i + 2}" for i in range(self.birds - 1)]),
                ("over neighbour", _cells(found.neighbour_gain_peak[m], ".4f")),
                ("at omega", _cells(found.neighbour_gain_frequency[m], ".5f")),
            ]
            if gust is not None:
                columns.append(("gap std", _cells(gust.gap_std[m], ".4g")))
                if np.isfinite(gust.gap_std_gibbs[m]).all():
                    columns.append(("Gibbs", _cells(gust.gap_std_gibbs[m], ".4g")))
        return _rows(columns)

    def _spans(self) -> list[str]:
        """Return the derivatives by span ratios, a row for each bird."""
        sensitivity, m = self.sensitivity, self.m
        assert sensitivity is not None
        columns = [
            ("bird", [str(i + 1) for i in range(self.birds)]),
            ("dU*/dlambda", _cells(sensitivity.speed_by_span[m], ".5f")),
            ("dmargin/dlambda", _cells(sensitivity.margin_by_span[m], ".5f")),
        ]
        if self.birds > 1:
            spacing = sensitivity.spacing_by_span[m]
            largest = np.argmax(np.abs(spacing), axis=0)
            moved = spacing[largest, np.arange(self.birds)]
            columns += [
                ("moves most", [f"gap {gap + 1}" for gap in largest]),
                ("by", _cells(moved, ".4g")),
            ]
        return ["", "  derivatives by the span ratio lambda of a bird", *_rows(columns)]


def _largest(values: FloatArray) -> int:
    """Return the index of the largest value, the first of those that differ by rounding only."""
    return int(np.argmax(values >= (1.0 - TIE) * values.max()))


def _cells(values: Any, form: str) -> list[str]:
    return [f"{value:{form}}" for value in values]


def _rows(columns: list[tuple[str, list[str]]]) -> list[str]:
    """Return the lines of a table, with columns aligned at their right ends."""
    widths = [max(len(name), *(len(cell) for cell in cells)) for name, cells in columns]
    rows = max(len(cells) for _, cells in columns)
    lines = ["  " + "   ".join(f"{name:>{width}}" for (name, _), width in zip(columns, widths))]
    for k in range(rows):
        cells = [
            f"{cells[k] if k < len(cells) else '':>{width}}"
            for (_, cells), width in zip(columns, widths)
        ]
        lines.append("  " + "   ".join(cells))
    return lines

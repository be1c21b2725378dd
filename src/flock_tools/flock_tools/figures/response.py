# SPDX-License-Identifier: Apache-2.0
"""The figure of a linear response: gains against frequency, and standard deviations in gusts."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullFormatter

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.response.frequencies import Frequencies
from flock_sim.response.linear_response import Gust, Response, neighbour_pairs, responses_of
from flock_sim.theory.delayed.linearisation import LINEAR, DelayedLinearisation
from flock_tools.figures.style import (
    ALARM,
    BLUE,
    FAINT,
    INK,
    PAGE,
    PRINT_STYLE,
    SMALL,
    VERMILLION,
    flock_name,
)

MOST_NAMED = 5
"""Largest number of birds of a wing that are named."""

MOST_CURVES = 24
"""Largest number of birds of a wing whose curves are drawn."""

ABOVE = 1.6
"""Highest frequency shown, over that of the fastest oscillation."""

LEVEL = 0.03
"""Largest change of the logarithm of a gain from omega = 0 to the lowest frequency shown."""

MOST_DECADES = 5.0
"""Largest range of the frequencies shown."""

STEEP = 20.0
"""Gain above which the axis of gains is logarithmic."""

BETWEEN = 6
"""Number of points that are drawn between two frequencies that resolve the response."""

OMEGA = "frequency $\\omega$ ($U_\\mathrm{min}/b$)"


def draw_response(
    configuration: FlockConfiguration, found: Response, member: int, lag: float, model: str
) -> Figure:
    """Return the figure of `member` (from 1), a flock of two birds or more, of a response at a lag.

    (a) and (b) are the gains over the leader and over the neighbour, (c) the gains from
    accelerations to gaps; with gusts, (d) and (e) are the standard deviations along the flock.
    """
    m = member - 1
    gust = found.gust
    rows = 1 if gust is None else 2
    with mpl.rc_context(PRINT_STYLE):
        figure = Figure(figsize=(PAGE, 0.5 + 2.2 * rows), layout="constrained")
        heading = flock_name(configuration, m)
        heading += f", lag {lag:g} ({model})" if lag else ""
        if not found.stable[m]:
            why = "unstable: no response" if found.exists[m] else "no steady state"
            figure.suptitle(f"{heading}: {why}", x=0.02, ha="left", fontsize=8)
            return figure
        figure.suptitle(heading, x=0.02, ha="left", fontsize=8)
        grid = figure.add_gridspec(rows, 6)
        axes = [figure.add_subplot(grid[0, 2 * k : 2 * k + 2]) for k in range(3)]
        _Curves(configuration, found, m, lag, model).draw(*axes)
        if gust is not None:
            left, right = figure.add_subplot(grid[1, :3]), figure.add_subplot(grid[1, 3:])
            _gusts(left, right, gust, m)
    return figure


class _Curves:
    """The curves of a member against frequency."""

    def __init__(
        self, configuration: FlockConfiguration, found: Response, m: int, lag: float, model: str
    ) -> None:
        self.found, self.m = found, m
        self.birds = configuration.birds
        self.leader = formation.leader(self.birds)
        flock = Flock.of(configuration).select(np.array([m]))
        motion = DelayedLinearisation.of(
            flock, found.spacing[m], float(found.speed[m]), lag, model if lag else LINEAR
        )
        self.responses = responses_of(flock, motion)
        peaks = np.concatenate(
            [
                found.speed_gain_frequency[m],
                found.neighbour_gain_frequency[m],
                [found.hinf_gaps_frequency[m], found.hinf_gaps_from_leader_frequency[m]],
            ]
        )
        peaks = peaks[np.isfinite(peaks) & (peaks > 0.0)]
        fastest = max(float(np.sqrt(2.0 * motion.pull.sum(axis=1).max())), *peaks, 1e-12)
        resolved = Frequencies.of(self.responses).omega
        self.high = ABOVE * fastest
        self.low = self._low(resolved)
        between = np.linspace(resolved[:-1], resolved[1:], BETWEEN, endpoint=False).ravel()
        inside = between[(between > self.low) & (between < self.high)]
        self.omega = np.unique(np.concatenate([[self.low], inside, peaks, [self.high]]))
        symmetric = np.allclose(motion.pull, motion.pull[::-1, ::-1], rtol=1e-6, atol=0.0)
        self.wings = ("left",) if symmetric or self.birds == 2 else ("left", "right")

    def _low(self, omega: FloatArray) -> float:
        """Return the frequency below which all gains are what they are at omega = 0."""
        of_gaps = self.responses.largest_gains(omega)[0]
        gains = np.column_stack([self.responses.followings(omega)[0], of_gaps])
        changed = (np.abs(gains - gains[0]) > LEVEL).any(axis=1)
        first = int(np.argmax(changed)) if changed.any() else len(omega) - 1
        low = min(float(omega[first]), 0.1 * self.high)
        return float(max(low, self.high * 10.0**-MOST_DECADES))

    def draw(self, over_leader: Axes, over_neighbour: Axes, gaps: Axes) -> None:
        """Draw all three panels."""
        found, m = self.found, self.m
        gains = self.responses.followings(self.omega)[0]
        outer, inner = neighbour_pairs(self.birds)
        of_neighbours = gains[:, outer] - gains[:, inner]
        birds = [index for index in range(self.birds) if index != self.leader - 1]
        self._panel(
            over_leader,
            {bird: np.exp(gains[:, bird]) for bird in birds},
            {
                bird: (found.speed_gain_frequency[m, bird], found.speed_gain_peak[m, bird])
                for bird in birds
            },
        )
        self._panel(
            over_neighbour,
            {int(bird): np.exp(of_neighbours[:, k]) for k, bird in enumerate(outer)},
            {
                int(bird): (
                    found.neighbour_gain_frequency[m, k],
                    found.neighbour_gain_peak[m, k],
                )
                for k, bird in enumerate(outer)
            },
        )
        over_leader.set(title="(a) gain over the leader", ylabel="$|u_i\\,/\\,u_\\mathrm{leader}|$")
        over_neighbour.set(
            title="(b) gain over the neighbour",
            ylabel="$|u_i\\,/\\,u_\\mathrm{nearer\\ to\\ leader}|$",
        )
        over_leader.legend(
            handles=self._names(),
            loc="best",
            fontsize=SMALL,
            handlelength=1.4,
            frameon=True,
            framealpha=0.8,
            edgecolor="none",
            labelspacing=0.25,
            borderpad=0.2,
        )
        self._gaps(gaps)

    def _panel(
        self,
        axes: Axes,
        curves: dict[int, FloatArray],
        peaks: dict[int, tuple[float, float]],
    ) -> None:
        axes.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)), zorder=1)
        for bird in self._shown(curves):
            axes.plot(self.omega, curves[bird], **self._line(bird))
            omega, peak = peaks[bird]
            if omega > 0.0:
                colour = self._line(bird)["color"]
                axes.plot(omega, peak, "o", color=colour, markersize=2.6, zorder=3)
        self._frequencies(axes)
        highest = max((float(curve.max()) for curve in curves.values()), default=1.0)
        if highest > STEEP:
            axes.set(yscale="log", ylim=(0.05, 2.0 * highest))
        else:
            axes.set_ylim(0.0, 1.1 * max(highest, 1.0))

    def _frequencies(self, axes: Axes) -> None:
        axes.set(xscale="log", xlim=(self.low, self.high), xlabel=OMEGA)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=True)

    def _gaps(self, axes: Axes) -> None:
        found, m = self.found, self.m
        axes.set(
            title="(c) gaps, per acceleration",
            yscale="log",
            ylabel="gain ($b^2/U_\\mathrm{min}^2$)",
        )
        self._frequencies(axes)
        for curve, name, text, colour in (
            (self.responses.largest_gains, "hinf_gaps", "all birds", INK),
            (self.responses.from_leader, "hinf_gaps_from_leader", "leader alone", BLUE),
        ):
            axes.plot(self.omega, np.exp(curve(self.omega)[0]), color=colour, label=text)
            omega, peak = getattr(found, f"{name}_frequency")[m], getattr(found, name)[m]
            # A maximum at omega = 0 is marked at the left edge.
            axes.plot(
                max(omega, self.low),
                peak,
                "o",
                color=colour,
                markersize=3.2,
                clip_on=False,
                zorder=3,
            )
        top = float(found.hinf_gaps[m])
        static = float(np.exp(self.responses.from_leader(np.zeros(1))[0][0]))
        axes.set_ylim(max(min(0.1 * static, 1e-2 * top), 1e-6 * top), 2.0 * top)
        axes.legend(loc="lower left", fontsize=SMALL, handlelength=1.4)

    def _shown(self, curves: dict[int, FloatArray]) -> list[int]:
        """Return the birds whose curves are drawn: of the left wing, and of both if they differ."""
        head = self.leader - 1
        left = [bird for bird in curves if bird < head]
        right = [bird for bird in curves if bird > head] if len(self.wings) == 2 else []
        return [bird for wing in (left, right) for bird in _spread_out(wing, MOST_CURVES)]

    def _line(self, bird: int) -> dict[str, Any]:
        head = self.leader - 1
        length = max(head, self.birds - 1 - head, 2)
        from_leader = abs(bird - head) / length
        style: Any = "-" if bird < head else (0, (4, 1.5))
        colour = mpl.colormaps["plasma"](0.85 * (1.0 - from_leader))
        return {"color": colour, "linestyle": style, "linewidth": 0.9, "zorder": 2}

    def _names(self) -> list[Line2D]:
        head = self.leader - 1
        wings = [list(range(head))]
        if len(self.wings) == 2:
            wings.append(list(range(head + 1, self.birds)))
        birds = [bird for wing in wings for bird in _spread_out(wing, MOST_NAMED)]
        return [Line2D([], [], label=f"bird {bird + 1}", **self._line(bird)) for bird in birds]


def _gusts(gaps: Axes, speeds: Axes, gust: Gust, m: int) -> None:
    """Draw the standard deviations of gaps and of speeds along the flock."""
    std, speed = gust.gap_std[m], gust.bird_speed_std[m]
    marks: dict[str, Any] = {"markersize": 3.6 if len(speed) <= 40 else 1.8, "linewidth": 0.7}
    place = np.arange(1, len(std) + 1)
    gaps.plot(place, std, "o-", color=INK, markerfacecolor="white", label="linear", **marks)
    if np.isfinite(gust.gap_std_gibbs[m]).all() and len(std):
        gaps.plot(place, gust.gap_std_gibbs[m], "x", color=ALARM, label="Gibbs", **marks)
        gaps.legend(loc="best", fontsize=SMALL)
    gaps.set(
        title=f"(d) gaps in gusts, STD = {gust.std:g}",
        xlabel="gap $i$, between birds $i$ and $i+1$",
        ylabel="standard deviation ($b$)",
    )
    place = np.arange(1, len(speed) + 1)
    speeds.plot(place, speed, "o-", color=INK, markerfacecolor="white", **marks)
    for value, text, colour in (
        (gust.mean_speed_std[m], "of the mean speed", BLUE),
        (gust.speed_spread_rms[m], "root mean square of $\\sigma_U$", VERMILLION),
    ):
        speeds.axhline(value, color=colour, linewidth=0.9, label=text)
    speeds.legend(loc="best", fontsize=SMALL)
    speeds.set(
        title="(e) speeds", xlabel="bird $i$", ylabel="standard deviation ($U_\\mathrm{min}$)"
    )
    for axes in (gaps, speeds):
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.ticklabel_format(axis="y", scilimits=(-3, 3))
        axes.grid(visible=True)


def _spread_out(birds: list[int], most: int) -> list[int]:
    """Return up to `most` of the birds, evenly spaced, with the first and the last."""
    if len(birds) <= most:
        return birds
    return [birds[round(k)] for k in np.linspace(0, len(birds) - 1, most)]

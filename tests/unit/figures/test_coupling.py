# SPDX-License-Identifier: Apache-2.0
"""The figure of the coupling study is legible, and explains its lines and scales."""

from __future__ import annotations

from matplotlib.figure import Figure

from flock_sim.theory.delayed.linearisation import HOLD, LINEAR
from flock_tools.experiments.coupling_study import Delayed, Held
from flock_tools.figures.coupling import draw_study
from support.legibility import cut_off, overlaps

CRITICAL = 40.0


def study() -> Figure:
    delayed = [
        Delayed(model, delay, delay + 0.5, 1.2, 0.3, 0.1, 1e4 + delay, 1.2, 0.3)
        for model in (HOLD, LINEAR)
        for delay in (0, 20, 45)
    ]
    held = [
        Held(model, key, value, (0.96, 1.0, 1.07))
        for model in (HOLD, LINEAR)
        for key, values in (
            ("interval", (2.0, 10.0)),
            ("drop", (0.1, 0.9)),
            ("delay", (5.0, 20.0)),
        )
        for value in values
    ]
    return draw_study(delayed, held, CRITICAL)


def test_the_line_of_the_critical_lag_is_explained() -> None:
    figure = study()
    (explained,) = figure.legends[0].legend_handles
    for axes in figure.axes[:3]:
        (line,) = (line for line in axes.lines if list(line.get_xdata()) == [CRITICAL, CRITICAL])
        assert line.get_linestyle() == explained.get_linestyle() == ":"
    (told,) = figure.legends[0].get_texts()
    assert "`linear` loses stability" in told.get_text()


def test_a_logarithmic_scale_says_so() -> None:
    for axes in study().axes:
        for scale, label in (
            (axes.get_xscale(), axes.get_xlabel()),
            (axes.get_yscale(), axes.get_ylabel()),
        ):
            assert ("logarithmic" in label) == (scale == "log")


def test_the_figure_is_legible() -> None:
    figure = study()
    assert not cut_off(figure)
    assert not overlaps(figure)

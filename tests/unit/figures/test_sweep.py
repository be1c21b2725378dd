# SPDX-License-Identifier: Apache-2.0
"""The picture of a sweep is legible, and explains what it shows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flock_tools.figures.sweep import draw_sweep
from flock_tools.figures.sweep_labels import flock_title
from support.legibility import cut_off, overlaps, texts
from unit.experiments.test_sweep import AXES, asked, flown


def test_the_picture_has_a_panel_of_mean_speed(tmp_path: Path) -> None:
    swept = asked({"span_ratio[2]": [1.0, 0.9, 1.1]})
    found = flown(swept, tmp_path / "one")
    _, spacing, speed = draw_sweep(found, swept).axes
    assert spacing.get_ylabel() == "mean spacing (b)"
    assert speed.get_ylabel() == "mean speed ($U_\\mathrm{min}$)"
    assert speed.lines[0].get_ydata().tolist() == found.mean_speed.values[[1, 0, 2]].tolist()
    swept = asked({"position[1]": [0.0, -0.25], "span_ratio[2]": [0.9, 1.0]})
    found = flown(swept, tmp_path / "two")
    cells = draw_sweep(found, swept).axes[2].collections[0].get_array()
    assert cells.tolist() == found.mean_speed.values[::-1].tolist()


def test_small_differences_are_not_magnified(tmp_path: Path) -> None:
    swept = asked({"position[1]": [0.0, 1e-6], "link.seed": [1, 2]})
    found = flown(swept, tmp_path)
    maps = draw_sweep(found, swept).axes[1:3]
    limits = [axes.collections[0].get_clim() for axes in maps]
    one = replace(swept, axes=swept.axes[:1])
    curves = draw_sweep(found.isel(link_seed=0), one).axes[1:]
    for (least, values), clim, axes in zip(
        ((0.1, found.mean_spacing), (0.01, found.mean_speed)), limits, curves, strict=True
    ):
        assert np.ptp(values.to_numpy()) < 1e-3 * least
        assert np.ptp(clim) == pytest.approx(least)
        assert least <= np.ptp(axes.get_ylim()) < 1.2 * least
        assert axes.get_yscale() == "linear"
        assert axes.yaxis.get_major_formatter().get_useOffset() is False


def test_the_title_tells_birds_coupling_and_links_by_name(tmp_path: Path) -> None:
    for axes, links, told in (
        (["span_ratio[2]"], [], "4 birds, nearest-neighbour coupling, exact links"),
        (["coupling"], [], "4 birds, exact links"),
        (["link.delay"], ["hold"], "coupling\nlinks: hold; delay of all links varies"),
        (["link[2->3].drop"], [], "exact links; probability of loss of link 2->3 varies"),
    ):
        swept = asked({name: AXES[name] for name in axes}, links=links)
        assert flock_title(swept).endswith(told)
        found = flown(swept, tmp_path / axes[0])
        assert draw_sweep(found, swept).get_suptitle().startswith(flock_title(swept) + "\n")


def test_axes_and_values_have_names_and_units_instead_of_keys(tmp_path: Path) -> None:
    names = ["link.delay", "span_ratio[2]", "speed[3]", "coupling"]
    swept = asked({name: AXES[name] for name in names})
    figure = draw_sweep(flown(swept, tmp_path), swept)
    told = " ".join(text.get_text() for text in texts(figure)).replace("\n", " ")
    assert "shown at coupling = nearest-neighbour" in told
    assert "change of the initial speed of bird 3 = 0.01 $U_\\mathrm{min}$" in told
    assert "delay of all links (steps)" in told
    assert not [name for name in names[:3] if name in told]


@pytest.mark.parametrize(
    "names",
    [
        ["span_ratio[2]"],
        ["coupling"],
        ["link[1->2].model"],
        ["coupling", "span_ratio[2]"],
        ["link.delay", "span_ratio[2]", "speed[3]"],
    ],
    ids="x".join,
)
def test_the_picture_of_a_sweep_is_legible_and_explains_its_lines(
    names: list[str], tmp_path: Path
) -> None:
    values = {**AXES, "speed[3]": [0.0, 1e200, 0.01]}
    swept = asked({name: values[name] for name in names})
    figure = draw_sweep(flown(swept, tmp_path), swept)
    assert not overlaps(figure)
    assert not cut_off(figure)
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("the paper's criterion" in text for text in told)
    assert ("diverged" in told) == (len(names) == 3)
    assert ("settling" in told) == (len(names) == 1)


def test_marks_and_borders_are_those_of_the_verdicts(tmp_path: Path) -> None:
    swept = asked({"span_ratio[2]": [0.9, 1.0, 1.1], "position[1]": [0.0, 0.1]})
    found = flown(swept, tmp_path)
    found.verdict.values[:] = [[2, 2], [0, 0], [1, 1]]
    told = [text.get_text() for text in draw_sweep(found, swept).legends[0].get_texts()]
    assert told[0] == "border of the flocks that hold (verdict)"
    one = replace(swept, axes=swept.axes[:1])
    figure = draw_sweep(found.isel(initial_position_1=0), one)
    marked = {line.get_label(): line for line in figure.axes[2].lines[1:]}
    assert {word: line.get_xdata().tolist() for word, line in marked.items()} == {
        "holds": [1.0],
        "settling": [1.1],
        "apart": [0.9],
    }
    assert marked["holds"].get_markerfacecolor() != "white"
    assert marked["apart"].get_markerfacecolor() == "white"

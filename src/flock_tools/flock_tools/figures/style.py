# SPDX-License-Identifier: Apache-2.0
"""The common style of all pictures: colours, fonts, and the name of a flock."""

from __future__ import annotations

from typing import Any

import numpy as np

from flock_sim.configuration.flock_configuration import FlockConfiguration

INK, FAINT, PALE = "#22303c", "#8a949d", "#bfc6cc"
ALARM = "#b5382a"

SKY, BLUE, GREEN, ORANGE, VERMILLION = "#56b4e9", "#0072b2", "#009e73", "#e69f00", "#d55e00"
"""Colours that are distinct for colour-blind readers, too (Okabe and Ito)."""

STYLE: dict[Any, Any] = {
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "text.color": INK,
    "xtick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.color": FAINT,
    "ytick.labelcolor": INK,
}

COLUMN, PAGE = 3.4, 7.0
"""Widths of printed figures of one and of two columns, in inches."""

SMALL = 7.0
"""Smallest font size in print, in pt."""

PRINT_STYLE: dict[Any, Any] = {
    **STYLE,
    "axes.axisbelow": True,
    "axes.labelsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.titlelocation": "left",
    "axes.titlesize": 8.0,
    "font.size": 7.5,
    "grid.color": "#eceff1",
    "grid.linewidth": 0.6,
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "legend.title_fontsize": SMALL,
    "lines.linewidth": 0.9,
    "lines.markersize": 3.6,
    "lines.markeredgewidth": 0.8,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
}
"""Style of figures that are drawn at their printed size."""

COUPLING_NAMES = {"nearest": "nearest-neighbour", "all": "all-to-all"}

MOST_ODD = 4
"""Largest number of birds of another span that are named."""


def flock_name(configuration: FlockConfiguration, m: int) -> str:
    """Return the name of the flock with index `m`: birds, coupling, birds of another span."""
    birds = configuration.birds
    name = f"{birds} bird{'s' * (birds > 1)}"
    if birds > 1:
        name += f", {COUPLING_NAMES[configuration.coupling]} coupling"
    if configuration.members > 1:
        name += f", member {m + 1} of {configuration.members}"
    ratio = configuration.span_ratio[:, m]
    odd = np.flatnonzero(ratio != 1.0)
    if 0 < len(odd) <= MOST_ODD:
        name += "".join(f", $\\lambda_{{{i + 1}}}$ = {ratio[i]:g}" for i in odd)
    elif len(odd):
        name += f", $\\lambda$ from {ratio.min():g} to {ratio.max():g}"
    return name

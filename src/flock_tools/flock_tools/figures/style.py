# SPDX-License-Identifier: Apache-2.0
"""The common style of all pictures: colours, fonts, the scale of saved drag, names of flocks."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing.settings import Settings
from flock_sim.links.keys import NUMBERS
from flock_sim.links.settings import parted
from flock_sim.model_text import SEPARATOR
from flock_sim.physics.arrays import FloatArray

INK, FAINT, PALE = "#22303c", "#8a949d", "#bfc6cc"
ALARM = "#b5382a"

SKY, BLUE, GREEN, ORANGE, VERMILLION = "#56b4e9", "#0072b2", "#009e73", "#e69f00", "#d55e00"
"""Colours that are distinct for colour-blind readers, too (Okabe and Ito)."""

# Light means little drag saved, dark means much. The lightest end is invisible on paper.
DRAG_SAVED = LinearSegmentedColormap.from_list(
    "drag saved", mpl.colormaps["viridis_r"](np.linspace(0.08, 1.0, 256))
)

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

UNITS = {"U_min": "$U_\\mathrm{min}$", "b/U_min": "b/$U_\\mathrm{min}$"}
"""How units that are not plain text are written."""

COUPLING_NAMES = {"nearest": "nearest-neighbour", "all": "all-to-all"}

MOST_ODD = 4
"""Largest number of birds of another span that are named."""

MOST_LINKS = 2
"""Largest number of settings of links that are named."""

LINE = 95
"""Number of characters of a line of a title."""


def saved_scale(saved: FloatArray) -> Normalize:
    """Return the colour scale of drag reductions, in %.

    A scale fitted to each picture would exaggerate negligible differences.
    """
    known = saved[np.isfinite(saved)]
    return Normalize(
        min(0.0, 5.0 * np.floor(known.min(initial=0.0) / 5.0)),
        max(20.0, 5.0 * np.ceil(known.max(initial=0.0) / 5.0)),
    )


def flock_name(configuration: FlockConfiguration, m: int) -> str:
    """Return the name of the flock with index `m`: birds, coupling, links, birds of another span.

    Links that are not exact, and forcing, have a line of their own.
    """
    birds = configuration.birds
    name = f"{birds} bird{'s' * (birds > 1)}"
    late = birds > 1 and not configuration.link_table.plain
    if birds > 1:
        name += f", {COUPLING_NAMES[configuration.coupling]} coupling"
        name += "" if late else ", exact links"
    if configuration.members > 1:
        name += f", member {m + 1} of {configuration.members}"
    ratio = configuration.span_ratio[:, m]
    odd = np.flatnonzero(ratio != 1.0)
    if 0 < len(odd) <= MOST_ODD:
        name += "".join(f", $\\lambda_{{{i + 1}}}$ = {ratio[i]:g}" for i in odd)
    elif len(odd):
        name += f", $\\lambda$ from {ratio.min():g} to {ratio.max():g}"
    lines = [name]
    if late:
        lines.append(links_name(configuration.links, m))
    if configuration.forcing:
        lines.append(forcing_name(configuration.forcing_table.entries, m))
    return "\n".join(lines)


def forcing_name(entries: Sequence[Settings], m: int) -> str:
    """Return the forcing in words, with the values of the member with index `m`.

    If there are more than MOST_LINKS entries, it has the first of them, and the number of others.
    """
    named = [_term_name(entry, m) for entry in entries[:MOST_LINKS]]
    if len(entries) > MOST_LINKS:
        named.append(f"{len(entries) - MOST_LINKS} more")
    return fill(f"forcing: {'; '.join(named)}", LINE)


def _term_name(entry: Settings, m: int) -> str:
    values = [(key, text.split(SEPARATOR)) for key, text in entry.items]
    facts = [f"{key} {given[m] if len(given) > 1 else given[0]}" for key, given in values]
    whose = f"bird {entry.bird}: " if entry.bird is not None else ""
    law = entry.name.rpartition(":")[2]
    return f"{whose}{law}{' with ' * bool(facts)}{', '.join(facts)}"


def links_name(links: Sequence[str], m: int) -> str:
    """Return the settings of links in words, with the values of the member with index `m`.

    If there are more than MOST_LINKS, it has the first of them, and the number of the others.
    """
    named = [_link_name(entry, m) for entry in links[:MOST_LINKS]]
    if len(links) > MOST_LINKS:
        named.append(f"{len(links) - MOST_LINKS} more")
    return fill(f"links: {'; '.join(named)}", LINE)


def _link_name(entry: str, m: int) -> str:
    link, model, items = parted(entry)
    facts = [_fact(key, values.split(SEPARATOR), m) for key, values in items]
    birds = f"bird {link[0]} to bird {link[1]}: " if link else ""
    return f"{birds}{model}{' with ' * bool(facts)}{', '.join(facts)}"


def _fact(key: str, values: Sequence[str], m: int) -> str:
    """Return the meaning, the value and the unit of one key of a link."""
    value = values[m] if len(values) > 1 else values[0]
    found = NUMBERS.get(key)
    if found is None:
        return f"{key} of position and speed {value}"
    unit = "" if found.unit == "1" else f" {UNITS.get(found.unit, found.unit)}"
    return f"{found.meaning} {value}{unit}"

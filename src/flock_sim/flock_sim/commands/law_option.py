# SPDX-License-Identifier: Apache-2.0
"""The option --law: the files of the laws with which a recorded flight was flown."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration
    from flock_sim.recording.own_parts import OwnPart

LAW_WITHOUT_BAG = (
    "--law names the law of a recorded flight: use it with --resume or --repeat; for a new flight "
    "give --forcing FILE.py:LAW"
)


def add_law_option(parser: argparse.ArgumentParser, bag: str) -> None:
    """Add --law; `bag` is the option that names the recorded flight."""
    parser.add_argument(
        "--law",
        metavar="FILE",
        action="append",
        help=f"with {bag}: the file with a forcing law of the flight, unchanged, or the name of an "
        "installed law; may be repeated",
    )


def load_recorded_laws(
    parts: Sequence[OwnPart],
    configuration: FlockConfiguration,
    given: Sequence[str] | None,
    where: str,
) -> None:
    """Load the laws of a recorded flight from `given`, and check the values of its forcing.

    `parts` are its own parts; `where` names the flight in errors. Raises FlockError if a law is not
    among `given`, or differs.
    """
    from flock_sim.forcing.own_laws import place
    from flock_sim.links import installed
    from flock_sim.links.registry import check_known
    from flock_sim.recording.own_parts import LAW, LINK_MODEL, digests

    given = given or ()
    links = installed.place(digests(parts, LINK_MODEL), given, where)
    place(digests(parts, LAW), [text for text in given if text not in links], where)
    table = configuration.link_table
    check_known(settings.model for settings in table.used())
    configuration.forcing_table.check()

# SPDX-License-Identifier: Apache-2.0
"""Data behind a picture, as a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO


@dataclass(frozen=True)
class Table:
    """Rows of values under names that tell their units; `_2b` and the like say over what."""

    columns: tuple[str, ...]
    rows: list[Sequence[object]]

    def csv(self) -> bytes:
        """Return the file: the names, then the rows; every digit of a number, nothing for None."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return text.getvalue().encode()


def _plain(value: object) -> object:
    """Return `value` as what writes itself plainly, unlike numpy's numbers."""
    plain = value.item() if hasattr(value, "item") else value
    return str(plain).lower() if isinstance(plain, bool) else plain

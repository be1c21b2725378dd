# SPDX-License-Identifier: Apache-2.0
"""The data of a picture, as a CSV file."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO


@dataclass(frozen=True)
class Table:
    """Rows of values under column names that give the units, such as `_2b` for multiples of 2b."""

    columns: tuple[str, ...]
    rows: list[Sequence[object]]

    def csv(self) -> bytes:
        """Return the CSV file. Numbers have all digits; None is an empty cell."""
        text = StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_plain(value) for value in row] for row in self.rows)
        return text.getvalue().encode()


def _plain(value: object) -> object:
    """Return `value` as a plain Python value, also for numpy's numbers."""
    plain = value.item() if hasattr(value, "item") else value
    return str(plain).lower() if isinstance(plain, bool) else plain

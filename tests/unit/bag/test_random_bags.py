# SPDX-License-Identifier: Apache-2.0
"""Whatever a bag contains, it is read or refused, in limited memory, and imports no foreign code.

`make fuzz` sets FLOCK_FUZZ, the number of changed bags.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

BAGS = int(os.environ.get("FLOCK_FUZZ", "300"))

DEADLINE = 120 + BAGS
"""Time after which the readers count as hung, in s: fifty times what they take."""

TESTS = Path(__file__).parents[2]


def test_a_changed_bag_is_read_or_refused(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "support.read_bags", tmp_path, "0", str(BAGS)],
        cwd=TESTS,
        capture_output=True,
        text=True,
        check=False,
        timeout=DEADLINE,
    )
    assert done.returncode == 0, done.stdout + done.stderr

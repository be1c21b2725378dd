# SPDX-License-Identifier: Apache-2.0
"""What all tests have: an environment that no other test has touched, and how hypothesis searches.

It does so repeatably in every run; `--hypothesis-profile=search` looks further.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from unittest.mock import patch

import pytest
from hypothesis import HealthCheck, settings

# No deadline: the first example of a kernel pays for its compiler, and machines differ.
# No database: the same tree gives the same verdict, whatever was run before.
settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
settings.register_profile(
    "search",
    deadline=None,
    database=None,
    max_examples=3000,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def _own_environment() -> Iterator[None]:
    """Forget what a test has put into the environment: tools that run in this process do so.

    What a later test starts would otherwise go by the settings for DDS of an earlier one.
    """
    with patch.dict(os.environ):
        yield

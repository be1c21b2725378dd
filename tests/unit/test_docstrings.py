# SPDX-License-Identifier: Apache-2.0
import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "module", ["free_bird", "links.receiver", "monolith", "protocol", "timekeeper"]
)
def test_examples_in_docstrings_do_what_they_say(module):
    result = doctest.testmod(importlib.import_module(f"flock_sim.core.{module}"))
    assert result.attempted > 0
    assert result.failed == 0

# SPDX-License-Identifier: Apache-2.0
import doctest
import importlib

import pytest


@pytest.mark.parametrize(
    "module",
    [
        "protocol.bird",
        "protocol.clock",
        "protocol.free_bird",
        "protocol.link_receiver",
        "reference.integrator",
    ],
)
def test_examples_in_docstrings_do_what_they_say(module):
    result = doctest.testmod(importlib.import_module(f"flock_sim.{module}"))
    assert result.attempted > 0
    assert result.failed == 0

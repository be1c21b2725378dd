# SPDX-License-Identifier: Apache-2.0
"""How hypothesis searches: repeatably in every run; `--hypothesis-profile=search` looks further."""

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

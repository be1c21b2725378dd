# SPDX-License-Identifier: Apache-2.0
"""The name LINEAR at its old place, for `protocol.latest_values`."""

from flock_sim.links.models import LINEAR as LINEAR

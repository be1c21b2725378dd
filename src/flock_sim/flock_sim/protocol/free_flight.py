# SPDX-License-Identifier: Apache-2.0
"""Limits of a free flight: no configured delay or loss, no stage records, no rewind."""

from __future__ import annotations

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.links.registry import MODELS

NO_WAY_BACK = (
    "a node was started again, and a free flight can't return to an earlier step: fly again"
)

GONE = "it is a free flight, and the messages that its birds had received are lost"


def check_free(
    configuration: FlockConfiguration, factor: float, timeout: float, record_stages: bool
) -> None:
    """Raise FlockError if a flight with these settings can't be free.

    `factor` is the real-time factor. `timeout` is the longest standstill, in s: a step must take at
    most half of it.
    """
    _check_links(configuration)
    if record_stages:
        raise FlockError(
            "a free flight has no Runge-Kutta stages to record, since birds send one state a step: "
            "leave --record-stages out"
        )
    step = configuration.dt * configuration.second / factor
    if step > 0.5 * timeout:
        raise FlockError(
            f"real-time factor {factor:g}: a step would take {step:.4g} s; it must take at most "
            f"half of the timeout of {timeout:g} s: raise one of them"
        )


def _check_links(configuration: FlockConfiguration) -> None:
    """Raise FlockError if a link has a setting that only lockstep supports."""
    for settings in configuration.link_table.used():
        if not settings.faultless or settings.interval > 1:
            raise FlockError(
                f"link {settings.text!r}: in a free flight the network itself delays and loses "
                "messages, and birds send every step; leave out all but "
                f"{MODELS[settings.model].name}"
            )

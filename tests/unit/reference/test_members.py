# SPDX-License-Identifier: Apache-2.0
"""A member has the same bits, whether it flies alone or with any number of others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from random import Random

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock_state import FlockState
from flock_sim.reference.integrator import Reference
from support.golden_flights import digest_of

STEPS = 40
SPANS = [f"{0.8 + 0.001 * k:.3f}" for k in range(400)]
FAULTS = {
    "delay": ["0", "1", "4"],
    "jitter": ["0", "2"],
    "drop": ["0", "0.3", "0.7"],
    "position_noise": ["0", "0.02"],
    "speed_noise": ["0", "0.001"],
    "position_quantum": ["0", "0.01"],
    "speed_quantum": ["0", "0.001"],
    "range": ["inf", "4"],
    "timeout": ["inf", "2"],
    "seed": ["1", "2", "3"],
}


@dataclass(frozen=True)
class Ensemble:
    """Members whose spans, links and pushes differ. Those of a member depend on its number only."""

    birds: int
    coupling: str
    differ: Sequence[int]
    """The birds whose span ratios differ among members."""
    links: Mapping[str, Mapping[str, Sequence[str]]] = field(default_factory=dict)
    """The beginning of each entry, and the values of its other keys that members may have."""

    def of(self, members: Sequence[int]) -> FlockConfiguration:
        """Return the flight of these members, together."""

        def drawn(what: str, values: Sequence[str]) -> list[str]:
            return [Random(f"{what} of {member}").choice(values) for member in members]

        links = []
        for entry, keys in self.links.items():
            items = [f"{key}={'/'.join(drawn(entry + key, keys[key]))}" for key in keys]
            links.append(entry + ",".join(items))
        pushes = [f"1@{STEPS // 2}=0.3,-0.01", "2@0=-0.1"]
        for place, member in enumerate(members, 1):
            if member % 3 == 0:
                pushes.append(f"3:{place}@{member % STEPS}=0.2,0.02")
            if member % 5 == 4:
                pushes.append(f"2:{place}@{member % STEPS}=0,1e200")  # this member diverges
        return FlockConfiguration(
            birds=self.birds,
            coupling=self.coupling,
            t_max=STEPS,
            record_every=1,
            span_ratios=tuple(
                f"{bird}={','.join(drawn(f'{bird}', SPANS))}" for bird in self.differ
            ),
            links=tuple(links),
            perturbations=tuple(pushes),
        )


ENSEMBLES = {
    "nearest": Ensemble(13, "nearest", [3, 4, 13]),
    "all-to-all": Ensemble(6, "all", [2, 5]),
    "exact links": Ensemble(4, "nearest", [2, 3], {"exact:": FAULTS}),
    "held links": Ensemble(4, "all", [1, 3], {"hold:interval=2,": FAULTS}),
    "links of pairs": Ensemble(
        4, "nearest", [1, 4], {"hold:": {"delay": ["2", "3"]}, "2->3=linear:interval=3,": FAULTS}
    ),
}


def states(configuration: FlockConfiguration) -> list[FlockState]:
    return list(Reference(configuration).fly())


def only(flown: list[FlockState], place: int) -> list[FlockState]:
    """Return the states of one member."""
    names = ("position", "speed", "circulation", "interaction_drag")
    return [
        replace(state, **{name: getattr(state, name)[:, place : place + 1] for name in names})
        for state in flown
    ]


@pytest.mark.parametrize("count", [2, 3, 7, 8, 13, 64, 1000])
@pytest.mark.parametrize("name", ENSEMBLES)
def test_members_that_fly_together_have_the_bits_of_each_alone(name: str, count: int) -> None:
    ensemble = ENSEMBLES[name]
    together = states(ensemble.of(range(count)))
    for member in Random(count).sample(range(count), min(count, 64)):
        alone = states(ensemble.of([member]))
        assert digest_of(only(together, member)) == digest_of(alone), member


@pytest.mark.parametrize("name", ENSEMBLES)
def test_these_members_differ_and_some_diverge(name: str) -> None:
    flown = states(ENSEMBLES[name].of(range(64)))
    assert len({digest_of(only(flown, place)) for place in range(64)}) == 64
    finite = np.isfinite(flown[-1].speed).all(axis=0)
    assert 32 <= finite.sum() < 64

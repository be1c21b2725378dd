# SPDX-License-Identifier: Apache-2.0
"""The golden flights have the committed digests, and leave out nothing that can be configured.

tests/support/golden_flights.py tells what a changed digest means.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import KEYS
from flock_sim.forcing.registry import BUILT_IN as FORCING
from flock_sim.forcing.settings import Settings
from flock_sim.links.keys import BOTH, INTERVAL, NUMBERS
from flock_sim.links.keys import KEYS as LINK_KEYS
from flock_sim.links.registry import BUILT_IN, MODELS
from flock_sim.links.settings import parted
from flock_sim.model_text import SEPARATOR
from flock_sim.reference.integrator import Reference
from support.golden_flights import FLIGHTS, committed_digests, digest_of, golden_digest


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_golden_flight_has_the_committed_digest(name: str) -> None:
    assert golden_digest(name) == committed_digests()[name]


def test_a_digest_is_committed_for_each_golden_flight_and_no_other() -> None:
    assert list(committed_digests()) == list(FLIGHTS)
    assert len(set(committed_digests().values())) == len(FLIGHTS)


def test_the_last_bit_of_one_value_changes_the_digest() -> None:
    states = list(Reference(FLIGHTS["two birds"]).fly())
    digest = digest_of(states)
    for name in ("position", "speed", "circulation", "interaction_drag"):
        changed = getattr(states[-1], name).copy()
        changed[1, 0] = np.nextafter(changed[1, 0], np.inf)
        assert digest_of([*states[:-1], replace(states[-1], **{name: changed})]) != digest


@pytest.mark.parametrize("key", KEYS)
def test_golden_flights_use_each_key_of_the_configuration(key: str) -> None:
    used = {getattr(flight, key) for flight in FLIGHTS.values()}
    assert used - {KEYS[key].default}
    assert used >= set(KEYS[key].choices)


def link_entries() -> Iterable[str]:
    return (entry for flight in FLIGHTS.values() for entry in flight.links)


def test_golden_flights_use_each_link_model() -> None:
    used = {parted(entry)[1] for entry in link_entries()}
    assert used == {model.name for model in MODELS[:BUILT_IN]}


@pytest.mark.parametrize("key", LINK_KEYS)
def test_golden_flights_use_each_key_of_a_link(key: str) -> None:
    given = [dict(parted(entry)[2]) for entry in link_entries()]
    values = {
        float(value) for items in given if key in items for value in items[key].split(SEPARATOR)
    }
    assert values - {NUMBERS[single].default for single in BOTH.get(key, (key,))}
    assert key == INTERVAL or any(SEPARATOR in items.get(key, "") for items in given)


def forcing_entries() -> Iterable[Settings]:
    return (entry for flight in FLIGHTS.values() for entry in flight.forcing_table.entries)


@pytest.mark.parametrize("name", FORCING)
def test_golden_flights_use_each_forcing_model_and_each_of_its_keys(name: str) -> None:
    used = [dict(entry.items) for entry in forcing_entries() if entry.name == name]
    for key, bounds in FORCING[name].keys.items():
        words = [items[key] for items in used if key in items]
        values = {float(value) for text in words for value in text.split(SEPARATOR)}
        assert values - {bounds.default}, key
        assert any(SEPARATOR in text for text in words), key
        # A key that may be left out is left out by an entry.
        assert key in FORCING[name].required or len(words) < len(used), key


def test_golden_flights_force_single_birds_and_all() -> None:
    assert {entry.bird is None for entry in forcing_entries()} == {False, True}


def test_golden_flights_use_each_form_of_links_spans_and_pushes() -> None:
    birds = [parted(entry)[0] for entry in link_entries()]
    assert None in birds
    assert any(birds)
    assert {flight.members for flight in FLIGHTS.values()} >= {1, 2, 3, 7, 64}
    assert {flight.birds for flight in FLIGHTS.values()} >= {1, 2, 6, 13, 101}
    pushed = [flight for flight in FLIGHTS.values() if flight.pushes]
    texts = {text for flight in pushed for text in flight.perturbations}
    assert {":" in text.partition("@")[0] for text in texts} == {False, True}
    steps = {
        (push.step == 0, push.step == flight.steps) for flight in pushed for push in flight.pushes
    }
    assert steps == {(True, False), (False, False), (False, True)}


def test_golden_flights_have_members_that_diverge_beside_members_that_do_not() -> None:
    *_, last = Reference(FLIGHTS["members that diverge"]).fly()
    finite = np.isfinite(last.position).all(axis=0)
    assert finite[[3, 5, 6]].all()  # those that are not pushed, or not far
    assert not finite[[0, 2, 4]].any()


def test_golden_flights_have_flocks_that_come_apart() -> None:
    *_, last = Reference(FLIGHTS["coming apart"]).fly()
    assert (np.ptp(last.position, axis=0) > 100.0).all()

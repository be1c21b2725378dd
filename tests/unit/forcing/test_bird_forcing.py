# SPDX-License-Identifier: Apache-2.0
"""The forcing of one bird: its noise, its state at the start, and a return to an earlier step."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.forcing.bird_forcing import BirdForcing
from flock_sim.forcing.stage import INITIAL, STEP, compute_force, normals
from flock_sim.physics import formation
from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.flock import Flock
from flock_sim.physics.runge_kutta import STAGES
from support.own_laws import law_file

NOISE = """
def first(noise):
    return noise[0]


def second(noise, factor=1):
    return factor * noise[1]
"""


def forcing_of(bird: int, flock: FlockConfiguration) -> BirdForcing:
    """Return the forcing of a bird whose neighbours are at its start."""
    constants = Flock.of(flock)
    around = formation.neighbours(bird, flock.birds, flock.coupling)
    forced = BirdForcing(
        bird,
        flock.birds,
        flock.forcing_table,
        constants.coefficients[bird - 1],
        flock.span_ratio[bird - 1],
        around,
        flock.dt,
    )
    forced.now[:] = 1.0
    forced.near[:] = 1.0
    return forced


def step(forced: BirdForcing, number: int, dt: float = 1.0) -> FloatArray:
    """Compute all stages of a step; return the forces, (stages, members)."""
    forces = []
    for stage in range(STAGES):
        assert compute_force(forced.words, STAGES * number + stage, dt)
        forces.append(forced.force.copy())
    return np.array(forces)


def test_noise_is_a_function_of_seed_bird_place_among_seeded_terms_and_step(
    tmp_path: Path,
) -> None:
    file = law_file(tmp_path, NOISE)
    entries = ["constant:force=0", f"2={file}:second:factor=10,seed=7", f"{file}:first:seed=5/6"]
    flock = FlockConfiguration.given({"birds": 3, "forcing": entries})
    for bird, ordinal in ((1, 0), (2, 1), (3, 0)):
        forced = forcing_of(bird, flock)
        for number in (0, 1, 5):
            expected = [normals(seed, bird, ordinal, number, STEP)[0] for seed in (5, 6)]
            if bird == 2:
                other = 10.0 * normals(7, 2, 0, number, STEP)[1]
                expected = [other + value for value in expected]
            # The same at all stages of the step.
            assert step(forced, number).tolist() == STAGES * [expected]


def test_members_with_equal_seeds_have_equal_noise_and_others_have_not(tmp_path: Path) -> None:
    file = law_file(tmp_path, NOISE)
    flock = FlockConfiguration.given({"birds": 1, "forcing": [f"{file}:first:seed=1/2/1/1"]})
    one, two, again, last = step(forcing_of(1, flock), 3)[0]
    assert one == again == last != two


def test_a_coloured_gust_begins_with_its_stationary_distribution() -> None:
    seeds = range(3000)
    entry = f"gust:std=0.5,time=9,seed={'/'.join(map(str, seeds))}"
    flock = FlockConfiguration(birds=3, forcing=("gust:std=0", entry))
    start = forcing_of(2, flock).start
    assert start.shape == (1, len(seeds))
    # It is the second seeded term of the bird.
    assert start[0, 7] == 0.5 * normals(7, 2, 1, 0, INITIAL)[0]
    assert np.std(start) == pytest.approx(0.5, rel=5.0 * math.sqrt(0.5 / len(seeds)))
    assert abs(start.mean()) < 5.0 * 0.5 / math.sqrt(len(seeds))


def test_a_coloured_gust_stays_stationary_and_forgets_within_its_time() -> None:
    seeds = range(3000)
    entry = f"gust:std=0.5,time=2,seed={'/'.join(map(str, seeds))}"
    forced = forcing_of(1, FlockConfiguration(birds=1, forcing=(entry,)))
    states = [forced.start[0].copy()]
    for number in range(6):
        step(forced, number)
        states.append(forced.start[0].copy())
    for lag, state in enumerate(states):
        assert np.std(state) == pytest.approx(0.5, rel=5.0 * math.sqrt(0.5 / len(seeds)))
        correlation = np.corrcoef(states[0], state)[0, 1]
        assert correlation == pytest.approx(
            math.exp(-lag / 2.0), rel=0, abs=5.0 / math.sqrt(len(seeds))
        )


def test_a_step_that_is_computed_again_from_its_state_is_the_same() -> None:
    """After a fault a bird begins an earlier step with the state on disk."""
    flock = FlockConfiguration(
        birds=2, forcing=("gust:std=0.5,time=2,seed=1/2", "1=gust:std=1,time=7,seed=3")
    )
    forced = forcing_of(1, flock)
    flown = []
    for number in range(8):
        state = forced.start.copy()
        flown.append((state, step(forced, number)))
    for number in (3, 4, 7, 0):
        again = forcing_of(1, flock)
        again.begin(flown[number][0])
        assert step(again, number).tobytes() == flown[number][1].tobytes()
    forced.begin()
    assert step(forced, 0).tobytes() == flown[0][1].tobytes()


def test_birds_with_fewer_state_numbers_have_zeros_for_the_others() -> None:
    flock = FlockConfiguration(birds=2, forcing=("gust:std=1,time=5", "1=gust:std=1,time=7"))
    forced = forcing_of(2, flock)
    assert forced.start.shape == (2, 1)
    step(forced, 0)
    assert forced.start[1].tolist() == [0.0]
    assert forced.start[0] != 0.0

# SPDX-License-Identifier: Apache-2.0
"""The numbers of a bag by a few lines of NumPy, to compare with those of the tools."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flock_sim.bag.reading.reader import BagReader
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.messages.state import ARRAYS
from flock_sim.messages.types import State

States = dict[tuple[int, int], State]


@dataclass
class BagArrays:
    """What a few lines read from a bag; arrays of shape (rows, birds, members)."""

    path: Path
    flown: FlockConfiguration
    states: States
    step: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    circulation: np.ndarray
    interaction_drag: np.ndarray
    mean_speed: np.ndarray
    mean_interaction_drag: np.ndarray

    @classmethod
    def read(cls, path: Path, flown: FlockConfiguration) -> BagArrays:
        states: States = {}
        with BagReader(path) as bag:
            for topic, _, data in bag.messages():
                if found := re.fullmatch(r"/flock/bird_(\d+)/state", topic):
                    state = State.decode(data)
                    states[int(found[1]), state.step] = state
        birds = range(1, flown.birds + 1)
        steps = sorted({step for _, step in states})
        steps = [step for step in steps if all((bird, step) in states for bird in birds)]
        arrays = (
            np.array([[getattr(states[bird, step], name) for bird in birds] for step in steps])
            for name in ARRAYS
        )
        return cls(path, flown, states, np.array(steps), *arrays)

    @property
    def time(self) -> np.ndarray:
        return self.step * self.flown.dt

    @property
    def leader(self) -> int:
        return self.flown.birds // 2 + 1

    @property
    def spacing(self) -> np.ndarray:
        return np.diff(self.position, axis=1)

    @property
    def relative(self) -> np.ndarray:
        return self.position - self.position[:, self.leader - 1][:, np.newaxis]

    @property
    def lateral(self) -> np.ndarray:
        ratio = self.flown.span_ratio
        apart = ratio[1:] + ratio[:-1] + np.pi / 4.0 - 1.0
        across = np.concatenate([np.zeros((1, ratio.shape[1])), np.cumsum(apart, axis=0)])
        return across - across[self.leader - 1]

    @property
    def cruise_drag(self) -> float:
        flown = self.flown
        square = (flown.cruise_speed / flown.min_drag_speed) ** 2
        return 2.0 * flown.zero_lift_drag / flown.aspect_ratio * (square + 1.0 / square)

    @property
    def saved(self) -> np.ndarray:
        return (0.0 - self.interaction_drag) / self.cruise_drag

    @property
    def spread(self) -> np.ndarray:
        return self.speed.std(axis=1)

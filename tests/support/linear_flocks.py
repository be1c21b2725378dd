# SPDX-License-Identifier: Apache-2.0
"""Flocks whose linear responses tests compute, and these responses by dense matrices."""

import numpy as np

from flock_sim.response.linear_response import responses_of
from flock_sim.theory.delayed.stability import delayed_linearisation, steady_flight
from flock_sim.theory.linear_stability import jacobian
from support.steady_flocks import positions_of, random_ratios
from support.steady_states import flock_of


def mixed_flock(birds, coupling="nearest", seed=1, spread=0.003):
    """A flock of one member whose birds differ, and which has a steady state."""
    ratios = random_ratios(seed=seed, birds=birds, members=40, spread=spread)
    for column in ratios.T:
        flock = flock_of(birds, column, coupling=coupling)
        if np.isfinite(steady_flight(flock, 0.0, "linear")[1]):
            return flock
    raise AssertionError("none of the flocks has a steady state")


def motion_of(flock, lag=0.0, model="linear"):
    """The linear equations of motion of a flock of one member."""
    motion = delayed_linearisation(flock, lag, model)
    assert motion.exists
    return motion


def responses(flock, lag=0.0, model="linear"):
    """The responses under test."""
    return responses_of(flock, motion_of(flock, lag, model))


def state_space(flock):
    """A, B of d(gaps, speeds)/dt = A (gaps, speeds) + B accelerations, from the full Jacobian."""
    birds = flock.birds
    spacing, speed = steady_flight(flock, 0.0, "linear")
    position = positions_of(spacing)[:, np.newaxis]
    full = jacobian(flock, position, np.full_like(position, speed))[0]
    behind = np.tril(np.ones((birds, birds)), -1)[:, : birds - 1]
    matrix = np.zeros((2 * birds - 1, 2 * birds - 1))
    matrix[: birds - 1, birds - 1 :] = np.diff(np.eye(birds), axis=0)
    matrix[birds - 1 :, : birds - 1] = full[birds:, :birds] @ behind
    matrix[birds - 1 :, birds - 1 :] = full[birds:, birds:]
    return matrix, np.vstack([np.zeros((birds - 1, birds)), np.eye(birds)])


def dense_response(flock, omega, lag=0.0, model="linear"):
    """Speeds and gaps per acceleration at one omega, (2 birds - 1, birds), by Delta, or A and B."""
    birds = flock.birds
    if lag == 0.0:
        matrix, force = state_space(flock)
        both = np.linalg.solve(1j * omega * np.eye(len(matrix)) - matrix, force)
        return np.vstack([both[birds - 1 :], both[: birds - 1]])
    position = np.linalg.inv(motion_of(flock, lag, model).characteristic(1j * omega))
    return np.vstack([1j * omega * position, np.diff(position, axis=0)])

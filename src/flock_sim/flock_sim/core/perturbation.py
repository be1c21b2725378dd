# SPDX-License-Identifier: Apache-2.0
"""Stub until merged."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Perturbation:
    step: int
    bird: int
    member: int
    position: float
    speed: float


def perturbations(configuration, text):
    return []

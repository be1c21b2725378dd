# SPDX-License-Identifier: Apache-2.0
"""All formulas of the paper's sections Model (solo flight) and Scaling.

The configuration has SI quantities. Inside Flock all quantities are dimensionless: length in b (the
standard semi-span), time in b / U_min, mass in rho b^3.

Powers are written as products: `**` is a function of the C library, and its last bit depends on the
machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from flock_sim.physics.arrays import FloatArray

if TYPE_CHECKING:
    from flock_sim.configuration.flock_configuration import FlockConfiguration

GRAVITY = 9.80665  # m/s^2, standard


def flapping_thrust(
    thrust_coefficient: float, air_density: float, area: float, frequency: float, amplitude: float
) -> float:
    """Return the mean thrust of a flapping cycle in N: C_T rho S (2 pi f A)^2. Eq. (thrust)."""
    speed = 2.0 * pi * frequency * amplitude
    return thrust_coefficient * air_density * area * (speed * speed)


@dataclass(frozen=True)
class StandardBird:
    """The standard bird in SI units: quantities that follow from the configuration."""

    configuration: FlockConfiguration

    @property
    def semi_span(self) -> float:
        """B / 2 = b, in m."""
        return 0.5 * self.configuration.wing_span

    @property
    def weight(self) -> float:
        """W = m g, in N."""
        return self.configuration.body_mass * GRAVITY

    @property
    def wing_area(self) -> float:
        """S = (2b)^2 / AR, in m^2."""
        bird = self.configuration
        return bird.wing_span * bird.wing_span / bird.aspect_ratio

    @property
    def profile_coefficient(self) -> float:
        """k_pro = C_D rho S / 2, in kg/m. Eq. (kpro)."""
        bird = self.configuration
        return 0.5 * bird.zero_lift_drag * bird.air_density * self.wing_area

    @property
    def induced_coefficient(self) -> float:
        """k_ind = W^2 / (2 pi e_O rho b^2), in kg m^3/s^4. Eq. (kind)."""
        bird = self.configuration
        loading = self.weight / self.semi_span
        return loading * loading / (2.0 * pi * bird.oswald_efficiency * bird.air_density)

    def drag(self, speed: float) -> float:
        """Return D = k_pro U^2 + k_ind U^-2 in N at `speed` in m/s. Eq. (D)."""
        square = speed * speed
        return self.profile_coefficient * square + self.induced_coefficient / square

    @property
    def minimum_drag_speed(self) -> float:
        """(k_ind / k_pro)^(1/4), in m/s. Eq. (Umin).

        The model uses the given U_min. This value shows how well e_O, C_D and AR agree with it.
        """
        return sqrt(sqrt(self.induced_coefficient / self.profile_coefficient))

    @property
    def minimum_drag(self) -> float:
        """2 sqrt(k_pro k_ind), in N. Eq. (Dmin)."""
        return 2.0 * sqrt(self.profile_coefficient * self.induced_coefficient)

    @property
    def unit_force(self) -> float:
        """rho b^2 U_min^2, in N, with the given U_min. Eq. (Fmin)."""
        rate = self.semi_span * self.configuration.min_drag_speed
        return self.configuration.air_density * (rate * rate)


@dataclass(frozen=True)
class Scales:
    """The dimensionless constants of the standard bird, shared by the whole flock."""

    mass_ratio: float
    """m_0 = M / (rho b^3)."""
    cruise_speed: float
    """U_0, in U_min."""
    drag_coefficient_k: float
    """k = 2 C_D / AR. Eq. (hatk)."""
    circulation_min: float
    """Gamma_min = 4 sqrt(e_O C_D / (pi AR)), in b U_min. Eq. (Gammamin)."""

    @classmethod
    def of(cls, bird: FlockConfiguration) -> Scales:
        """Return the constants of the standard bird of a configuration."""
        semi_span = 0.5 * bird.wing_span
        return cls(
            mass_ratio=bird.body_mass / (bird.air_density * (semi_span * semi_span * semi_span)),
            cruise_speed=bird.cruise_speed / bird.min_drag_speed,
            drag_coefficient_k=2.0 * bird.zero_lift_drag / bird.aspect_ratio,
            circulation_min=4.0
            * sqrt(bird.oswald_efficiency * bird.zero_lift_drag / (pi * bird.aspect_ratio)),
        )

    @property
    def cruise_ratio(self) -> float:
        """H_0 = (U_0^2 + U_0^-2) / 2: drag at cruise over least drag."""
        square = self.cruise_speed * self.cruise_speed
        return 0.5 * (square + 1.0 / square)

    @property
    def cruise_drag(self) -> float:
        """D_0 = T_0 = k (U_0^2 + U_0^-2), in rho b^2 U_min^2. Eqs. (hatD), (T0)."""
        return 2.0 * self.drag_coefficient_k * self.cruise_ratio

    @property
    def saving_ratio(self) -> float:
        """Gamma_min^2 / (2 pi k) = 4 e_O / pi^2: D_ij + D_ji in units of k E / U^2.

        A steady formation depends on e_O, C_D and AR only through this ratio.
        """
        square = self.circulation_min * self.circulation_min
        return square / (2.0 * pi * self.drag_coefficient_k)

    def solo_cruise_speed(self, span_ratio: FloatArray | float) -> FloatArray:
        """Return U_0,j of a bird of `span_ratio` lambda flying alone, in U_min; nan without one.

        This is the higher-speed, stable branch of T_j = D_j. It exists if lambda H_0 >= 1.
        """
        ratio = np.asarray(span_ratio, dtype=np.float64)
        square = ratio * self.cruise_ratio
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(ratio * (square + np.sqrt(square * square - 1.0))))


def drag_reduction(interaction_drag: FloatArray, cruise_drag: float) -> FloatArray:
    """Return eta_j = -(sum_i D_ij) / D_0; both drags in one unit. D_0 is `Scales.cruise_drag`."""
    # 0.0 - drag, not -drag: a bird alone saves 0, not -0.
    return (0.0 - interaction_drag) / cruise_drag


@dataclass(frozen=True)
class BirdCoefficients:
    """The coefficients of one bird's equation of motion, of shape (members,). Eq. (scaling)."""

    mass: FloatArray
    """m_j = lambda^3 m_0."""
    thrust: FloatArray
    """T_j = lambda^4 T_0."""
    profile_drag: FloatArray
    """lambda^2 k, the factor of U^2 in D_j."""
    induced_drag: FloatArray
    """lambda^4 k, the factor of U^-2 in D_j."""
    circulation: FloatArray
    """lambda^2 Gamma_min, the factor of 1 / U in Gamma_j."""

    @classmethod
    def of(cls, scales: Scales, span_ratio: FloatArray) -> BirdCoefficients:
        """Return the coefficients of a bird of `span_ratio` lambda, shape (members,)."""
        with np.errstate(over="ignore"):  # an overflow concerns only its member
            square = span_ratio * span_ratio
            return cls(
                mass=square * span_ratio * scales.mass_ratio,
                thrust=square * square * scales.cruise_drag,
                profile_drag=square * scales.drag_coefficient_k,
                induced_drag=square * square * scales.drag_coefficient_k,
                circulation=square * scales.circulation_min,
            )

    def rows(self) -> FloatArray:
        """Return the coefficients in the order of the kernels, shape (5, members)."""
        return np.stack(
            [self.mass, self.thrust, self.profile_drag, self.induced_drag, self.circulation]
        )

# SPDX-License-Identifier: Apache-2.0
"""Flights of birds that see their neighbours with a constant lag, for the tests of delayed theory.

They integrate the delay differential equations with an independent implementation of the paper's
formulas. They use nothing of the core.
"""

import numpy as np

from support.steady_flocks import H_0, MASS, STRENGTH, A, K, across, integral, surplus


class DelayedFlight:
    """RK4 with steps of lag / `steps_a_lag`. Past states are interpolated by Hermite's cubic.

    Arrays have shape (birds, members). Members may differ in `lag` (members,), and so in their
    steps. Before the start, all birds have flown at their speed for ever.
    """

    def __init__(self, ratios, position, speed, lag, model, steps_a_lag, mass=MASS):
        self.ratios, self.model, self.mass = ratios, model, mass
        self.lag = np.asarray(lag, dtype=float)
        self.dt = self.lag / steps_a_lag
        lateral = np.array([across(column) for column in ratios.T.tolist()]).T
        self.sources = np.array([i for j in range(len(ratios)) for i in (j - 1, j + 1)])
        self.targets = np.repeat(np.arange(len(ratios)), 2)
        inside = (self.sources >= 0) & (self.sources < len(ratios))
        self.sources, self.targets = self.sources[inside], self.targets[inside]
        source, target = ratios[self.sources], ratios[self.targets]
        self.across = lateral[self.sources] - lateral[self.targets]
        self.halves = (A * source, A * target)
        self.strength = 0.5 * STRENGTH * (source * target) ** 2
        self.sums = (np.arange(len(ratios))[:, np.newaxis] == self.targets).astype(float)
        self.position, self.speed = position.copy(), speed.copy()
        back = np.arange(-steps_a_lag, 0)[:, np.newaxis, np.newaxis] * self.dt
        self.past = [(position + t * speed, speed, 0.0 * speed) for t in back]

    def acceleration(self, position, speed, seen_position, seen_speed, seen_gain):
        """dU/dt of all birds from a past state of the others and its dU/dt. Eq. (eom3)."""
        seen_circulation = 1.0 / seen_speed
        if self.model == "linear":
            seen_position = seen_position + self.lag * seen_speed
            seen_circulation = seen_circulation - self.lag * seen_gain / seen_speed**2
        x = seen_position[self.sources] - position[self.targets]
        drags = self.strength * integral(x, self.across, *self.halves, of=np)
        drags *= seen_circulation[self.sources] / speed[self.targets]
        force = surplus(self.ratios, speed, H_0) - self.sums @ drags
        return K * force / (self.mass * self.ratios**3)

    def step(self):
        """Advance all members by one step, each with its own dt."""
        dt, x, u = self.dt, self.position, self.speed
        x_0, u_0, a_0 = self.past[0]
        slope = self.acceleration(x, u, x_0, u_0, a_0)
        self.past.append((x, u, slope))
        x_1, u_1, a_1 = self.past[1]
        middle = (
            0.5 * (x_0 + x_1) + 0.125 * dt * (u_0 - u_1),
            0.5 * (u_0 + u_1) + 0.125 * dt * (a_0 - a_1),
            1.5 * (u_1 - u_0) / dt - 0.25 * (a_0 + a_1),
        )
        second = self.acceleration(x + 0.5 * dt * u, u + 0.5 * dt * slope, *middle)
        speed_2 = u + 0.5 * dt * slope
        speed_3 = u + 0.5 * dt * second
        third = self.acceleration(x + 0.5 * dt * speed_2, speed_3, *middle)
        speed_4 = u + dt * third
        fourth = self.acceleration(x + dt * speed_3, speed_4, x_1, u_1, a_1)
        self.position = x + dt * (u + 2.0 * speed_2 + 2.0 * speed_3 + speed_4) / 6.0
        self.speed = u + dt * (slope + 2.0 * second + 2.0 * third + fourth) / 6.0
        del self.past[0]

    def advance(self, steps):
        """Advance by `steps`. Return the positions before each, (steps, birds, members)."""
        seen = []
        for _ in range(steps):
            seen.append(self.position)
            self.step()
        return np.array(seen)

# SPDX-License-Identifier: Apache-2.0
"""Laws of one's own, for flights of the tests: one without and one with state."""


def lean(bird, neighbours, time, gap=0.5, stiffness=2e-3, damping=5e-3, period=30.0):
    """Follow all known neighbours. The gap to those on the right grows for half of the time."""
    force = 0.0
    for k in range(len(neighbours.number)):
        if neighbours.circulation[k] == 0.0:
            continue
        wanted = gap * neighbours.lateral[k]
        if neighbours.lateral[k] > 0.0 and time % period < 0.5 * period:
            wanted += 0.1 * bird.span_ratio
        force += stiffness * (neighbours.position[k] - bird.position - wanted)
        force += damping * (neighbours.speed[k] - bird.speed)
    return force


def cruise(bird, state, step_state, noise, speed=1.03, gain=0.01, integral=1e-4, shake=0.0):
    """Hold a speed by proportional and integral control, with a shaking hand and a filter."""
    error = speed - bird.speed
    force = bird.mass * (gain * error + integral * state[0] + shake * (noise[0] - 0.5 * noise[1]))
    return force + 1e-5 * step_state[1], (error, 0.1 * (bird.thrust - state[1]))

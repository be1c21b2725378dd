# SPDX-License-Identifier: Apache-2.0
"""Two control laws of your own: the leader holds a speed, and the others hold a gap.

    ./flock fly --birds 5 --t-max 4000 --output runs/mine \
        --forcing 3=examples/my_laws.py:cruise:speed=1.1 \
        --forcing examples/my_laws.py:follow:gap=0.8
    ./flock reference --repeat runs/mine --law examples/my_laws.py --output runs/again
    ./flock compare runs/mine runs/again

The first command flies them over ROS 2, the second one in one loop. The bags are equal to the bit.
"""


def cruise(bird, speed=1.03, gain=0.1):
    """Pull a bird to a speed."""
    return gain * (speed - bird.speed)


def follow(bird, neighbours, state, gap=0.8, stiffness=0.02, damping=0.5, integral=1e-4):
    """Hold a gap to the neighbour towards the leader, with integral control."""
    if bird.number != bird.leader:
        ahead = bird.number + (1 if bird.number < bird.leader else -1)
        for k in range(len(neighbours.number)):
            if neighbours.number[k] == ahead and neighbours.circulation[k] != 0.0:
                error = neighbours.position[k] - bird.position - gap
                slower = neighbours.speed[k] - bird.speed
                force = stiffness * error + damping * slower + integral * state[0]
                return force, (error,)
    # A leader, or a bird that knows nothing of this neighbour: the integral stays as it is.
    return integral * state[0], (0.0,)

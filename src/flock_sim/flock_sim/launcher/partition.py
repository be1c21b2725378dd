# SPDX-License-Identifier: Apache-2.0
"""The partition of birds into processes, and its limits."""

import itertools

from flock_sim.console.arguments import whole_number
from flock_sim.errors import FlockError

MOST_PROCESSES = 60
"""Most processes of birds of a flight on one machine. Each discovers all others: on two cores, 60
were flying after 40 s, and 80 after 204 s; the timeout of `fly` is 60 s. Fast DDS has numbers for
100 processes on a domain: clock, recorder and observers need some too."""

MOST_ENDPOINTS = 10_000
"""Most publishers and subscriptions of the birds of one process. Fast DDS compares each new one
with all others: 3,240 took 2 s of processor time to create, 7,260 took 6 s, 12,880 took 14 s, and
as much to destroy."""


def partition(birds: int, processes: int) -> list[list[int]]:
    """Return the birds of each process, out of 1..`birds`: consecutive, in nearly equal shares."""
    bounds = [k * birds // processes for k in range(processes + 1)]
    return [list(range(low + 1, high + 1)) for low, high in itertools.pairwise(bounds)]


def process_count(name: str, text: str, birds: int, coupling: str) -> int:
    """Return `text`, the value of `name`, as the number of processes that share `birds`.

    Raises FlockError if this number of birds or of processes is not possible.
    """
    processes = whole_number(name, text, 1, birds)
    check_partition(birds, coupling, processes)
    if processes > MOST_PROCESSES:
        raise FlockError(
            f"{name} {processes}: too many processes of birds on one machine to discover each "
            f"other in time; give {MOST_PROCESSES} or fewer"
        )
    return processes


def check_partition(birds: int, coupling: str, processes: int) -> None:
    """Raise FlockError if one of the processes would have more than MOST_ENDPOINTS endpoints."""
    count = most_endpoints(birds, coupling, processes)
    if count <= MOST_ENDPOINTS:
        return
    words = "in one process" if processes == 1 else f"in {processes} processes"
    raise FlockError(
        f"{birds} birds with {coupling} coupling {words}: one process would have {count} "
        f"publishers and subscriptions, and at most {MOST_ENDPOINTS} are possible; "
        f"fly {_most_birds(birds, coupling, processes)} birds, or use more processes"
    )


def most_endpoints(birds: int, coupling: str, processes: int) -> int:
    """Return the publishers and subscriptions of the birds in the largest of the processes.

    A bird publishes wing, stage and state, and subscribes to wing and stage of each neighbour.
    """
    neighbours = birds - 1 if coupling == "all" else min(2, birds - 1)
    return -(-birds // processes) * (3 + 2 * neighbours)


def _most_birds(birds: int, coupling: str, processes: int) -> int:
    """Return the largest number of birds, less than `birds`, that `processes` can hold."""
    low, high = 1, birds
    while high - low > 1:
        middle = (low + high) // 2
        if most_endpoints(middle, coupling, processes) <= MOST_ENDPOINTS:
            low = middle
        else:
            high = middle
    return low

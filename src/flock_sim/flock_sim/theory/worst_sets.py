# SPDX-License-Identifier: Apache-2.0
"""The set of birds that is nearest to falling behind all others, by minimum cuts.

A steady state of all-to-all coupling exists if every set S of birds has a share s_S < 1 (see
`all_to_all`). With r_j = -R_j, c_ij = -C_ij > 0 and d_j = sum_i c_ij, the pairs within S are half
of the sum of its d_j less the pairs across, so

    s_S = 1/2 + load(S) / cut(S),    load_j = r_j - d_j / 2,    cut(S) = sum_{pairs across} c_ij.

Hence the largest share is that of the largest quotient load / cut. Dinkelbach's method finds it:
from the quotient q of a known set, the set with the largest load(S) - q cut(S) is the source's side
of a minimum cut, and has a larger quotient if there is one. Each round finds another set with a
larger share, so the search ends; two or three rounds are usual. The minimum cut is found by the
push-relabel method of Goldberg and Tarjan (J. ACM 35, 1988), whose pushes either empty a bird or
use a pair up, exactly so in floating-point numbers too.
"""

import numpy as np
import numpy.typing as npt

from flock_sim.physics.arrays import FloatArray
from flock_sim.physics.compile import kernel
from flock_sim.theory.all_to_all import share_of


@kernel
def find_worst_sets(
    needed: FloatArray,
    pairs: npt.NDArray[np.int64],
    saved: FloatArray,
    worst: npt.NDArray[np.bool_],
    margin: FloatArray,
) -> None:
    """Find the set of the largest share of each member, and its margin, one less this share.

    `needed` (birds, members) are R_j / k, `saved` (pairs, members) C_ij / k of all pairs. `worst`
    (birds, members) marks the birds of the sets from which the search starts, and then those of its
    results. The function fills `margin` (members,), with nan where `worst` marks no bird.
    """
    birds, members = needed.shape
    capacity = np.zeros((birds, birds))
    for m in range(members):
        behind, of_birds, of_pairs = worst[:, m].copy(), needed[:, m].copy(), saved[:, m].copy()
        if not np.any(behind):
            margin[m] = np.nan
            continue
        load = -of_birds
        for k in range(pairs.shape[0]):
            i, j = pairs[k, 0], pairs[k, 1]
            capacity[i, j] = capacity[j, i] = -of_pairs[k]
            load[i] += 0.5 * of_pairs[k]
            load[j] += 0.5 * of_pairs[k]
        largest = share_of(behind, of_birds, pairs, of_pairs)
        while True:
            behind = _most_loaded(load, (largest - 0.5) * capacity)
            if not np.any(behind) or np.all(behind):
                break
            share = share_of(behind, of_birds, pairs, of_pairs)
            if not share > largest:
                break
            worst[:, m], largest = behind, share
        margin[m] = 1.0 - largest


@kernel
def _most_loaded(load: FloatArray, capacity: FloatArray) -> npt.NDArray[np.bool_]:
    """Return the set S with the largest load(S) - capacity(S, others); the largest such set.

    `load` has shape (birds,), `capacity` (birds, birds); it is symmetric, and is changed. Positive
    loads flow to birds with negative ones, as far as capacities allow. At the end, the birds from
    which nothing can flow to a bird with room are the set.
    """
    birds = len(load)
    excess, room = np.maximum(load, 0.0), np.maximum(-load, 0.0)
    height = np.ones(birds, dtype=np.int64)  # a lower bound of the distance to the sink
    moved = True
    while moved:
        moved = False
        for i in range(birds):
            while excess[i] > 0.0 and height[i] <= birds:
                moved = True
                taken = min(excess[i], room[i])
                excess[i] -= taken
                room[i] -= taken
                lowest = birds
                for j in range(birds):
                    if capacity[i, j] > 0.0 and height[j] < height[i]:
                        pushed = min(excess[i], capacity[i, j])
                        excess[i] -= pushed
                        excess[j] += pushed
                        capacity[i, j] -= pushed
                        capacity[j, i] += pushed
                    if capacity[i, j] > 0.0:
                        lowest = min(lowest, height[j])
                if excess[i] > 0.0:
                    height[i] = lowest + 1

    stuck = room <= 0.0
    reaching = [i for i in range(birds) if not stuck[i]]
    while len(reaching) > 0:
        j = reaching.pop()
        for i in range(birds):
            if stuck[i] and capacity[i, j] > 0.0:
                stuck[i] = False
                reaching.append(i)
    return stuck

# SPDX-License-Identifier: Apache-2.0
"""The golden flights: short flights that together use everything that changes what is flown.

Their digests are committed in `golden_digests.json`. They are the same on every machine, whatever
its processor, C library and compiler. A digest that changes means that the values of flights change
for all users: what was recorded before can't be flown again, or continued with `--resume`, to the
same bits. Such a change needs an entry in CHANGELOG.md, which says why, and by how much.
`./flock python tests/golden.py --write` writes the digests of the present code.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from flock_sim.analysis.state_digest import StateDigest
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.physics.flock_state import FlockState
from flock_sim.reference.integrator import Reference

DIGESTS = Path(__file__).with_name("golden_digests.json")


def _flight(**parameters: Any) -> FlockConfiguration:
    """Return a flight. Its states are recorded at every step unless `parameters` say otherwise.

    The interaction drag depends on the last bits of the logarithm, but the next state rarely does.
    """
    return FlockConfiguration.from_parameters({"record_every": 1, **parameters})


def _spread(count: int, least: float, most: float) -> str:
    """Return as many span ratios, for as many members, with three decimals."""
    return ",".join(f"{least + k * (most - least) / (count - 1):.3f}" for k in range(count))


FLIGHTS: Mapping[str, FlockConfiguration] = {
    "one bird": _flight(
        birds=1,
        t_max=100,
        span_ratios=["1=0.9,1,1.2"],
        perturbations=["1@0=0,-0.02", "1:3@41=1.5"],
    ),
    "two birds": _flight(birds=2, t_max=300, span_ratios=["1=1.05"]),
    "even flock": _flight(birds=6, t_max=300, span_ratios=["3=0.97", "4=1.02"]),
    "thirteen birds": _flight(t_max=1000, record_every=10),
    "thirteen birds, all-to-all": _flight(t_max=400, coupling="all"),
    "a hundred and one birds": _flight(birds=101, t_max=100, span_ratios=["17=0.95", "90=1.1"]),
    "unequal birds": _flight(
        birds=7,
        t_max=600,
        span_ratios=["1=1.3", "2=0.7", "3=1.1", "4=0.9", "5=1.01", "6=0.85", "7=1.2"],
    ),
    "unequal birds, all-to-all": _flight(
        birds=8,
        coupling="all",
        t_max=200,
        span_ratios=["1=1.1", "2=0.8", "4=0.9,1,1.1", "5=1.2", "8=0.75,0.95,1.15"],
    ),
    "wing tips that nearly meet": _flight(
        birds=4, t_max=150, span_ratios=["2=0.001,0.02,0.1,0.3", "4=1.5"]
    ),
    "sixty-four members": _flight(
        birds=7, t_max=150, span_ratios=[f"3={_spread(64, 0.85, 1.15)}", "6=0.98"]
    ),
    "seven members, all-to-all": _flight(
        birds=5, coupling="all", t_max=300, span_ratios=[f"2={_spread(7, 0.9, 1.1)}"]
    ),
    "short steps": _flight(birds=5, dt=0.3, t_max=60, record_every=7),
    "long steps": _flight(birds=5, dt=7.5, t_max=2250, record_every=3),
    "very long steps": _flight(birds=5, dt=1000, t_max=2e5, span_ratios=["2=0.9,1,1.1"]),
    "another bird": _flight(
        birds=5,
        t_max=300,
        body_mass=1.35,
        wing_span=1.07,
        air_density=0.96,
        min_drag_speed=13.3,
        cruise_speed=14.9,
        oswald_efficiency=0.93,
        zero_lift_drag=0.0177,
        aspect_ratio=7.1,
        span_ratios=["4=1.04"],
    ),
    "pushes": _flight(
        birds=5,
        t_max=200,
        span_ratios=["3=0.98,1,1.02"],
        perturbations=[
            "1@0=0.3",
            "2:2@0=-0.1,0.01",
            "5@50=-0.4,0.02",
            "5:1@50=0.1,1e-3",
            "4:3@77=0,-0.03",
            "3@200=0.1,0.1",
        ],
    ),
    "coming apart": _flight(
        birds=5,
        t_max=3000,
        record_every=7,
        span_ratios=["2=0.8,1.2", "5=1.15,0.85"],
    ),
    "members that diverge": _flight(
        birds=5,
        t_max=60,
        span_ratios=["3=1,1,1,1.01,1,1,0.99"],
        perturbations=[
            "1:1@5=0,-1.027",
            "3:2@10=1e200",
            "4:3@20=0,1e160",
            "2:5@10=-1e308,1e308",
            "2:6@30=0,-3",
        ],
    ),
    "steps that diverge": _flight(
        birds=5, dt=4000, t_max=160000, span_ratios=["1=1.1,0.9,1", "2=0.6,1,1.4"]
    ),
    "held messages": _flight(birds=5, t_max=200, links=["hold:interval=10,delay=5"]),
    "extrapolated messages": _flight(
        birds=6,
        coupling="all",
        dt=0.5,
        t_max=100,
        span_ratios=["2=0.95"],
        links=["linear:interval=4,delay=3"],
    ),
    "late messages of every stage": _flight(
        birds=5, t_max=150, span_ratios=["4=0.97,1.03"], links=["exact:delay=3/0"]
    ),
    "lost messages": _flight(
        birds=5,
        t_max=200,
        links=["hold:interval=2,jitter=9/3/0,drop=0.3/0.5/0.9,timeout=12/inf/5,seed=1/2/2"],
    ),
    "lost messages of every stage": _flight(
        birds=5,
        coupling="all",
        t_max=150,
        links=["exact:delay=1,jitter=2,drop=0.4,seed=9007199254740992"],
    ),
    "messages of short range": _flight(
        birds=7,
        coupling="all",
        t_max=200,
        perturbations=["7@20=-30"],
        links=["linear:interval=5,range=4/8/1e3,timeout=40"],
    ),
    "noisy messages": _flight(
        birds=5,
        t_max=200,
        span_ratios=["2=1,1,1.02,0.98"],
        links=[
            "linear:interval=3,position_noise=0.02/0/0.03/0.01,speed_noise=0/1e-3/2e-4/1e-3,"
            "seed=3/3/4/5"
        ],
    ),
    "noisy messages of every stage": _flight(birds=4, t_max=150, links=["exact:noise=1e-3,seed=8"]),
    "rounded messages": _flight(
        birds=5,
        t_max=200,
        links=["linear:interval=2,position_quantum=0.01/0.1/0,speed_quantum=0/1e-3/0.003"],
    ),
    "rounded messages, all-to-all": _flight(
        birds=4, coupling="all", t_max=100, links=["hold:quantum=0.004,delay=2"]
    ),
    "links of single pairs": _flight(
        birds=5,
        t_max=200,
        span_ratios=["5=0.96,1,1.04"],
        links=[
            "hold",
            "linear:interval=2",
            "1->2=exact:noise=1e-3/0/2e-3,seed=11",
            "3->2=hold:interval=7,drop=0.2/0.4/0.6,delay=4,jitter=3,timeout=30",
            "5->4=exact",
            "3->4=linear:interval=3,range=2.5,quantum=0.01/0/0.02,delay=0/2/6",
        ],
    ),
    "one link of an exact flock": _flight(
        birds=6,
        coupling="all",
        t_max=150,
        links=["4->1=linear:interval=20,delay=15,position_noise=0.1,seed=77"],
    ),
    "forces that are functions of time": _flight(
        birds=5,
        dt=0.7,
        t_max=140,
        forcing=[
            "constant:force=1e-4/-2e-4/0",
            "4=sine:amplitude=1e-3/1e-3/2e-3,period=37/40/2.5,phase=0/0.25/0.7",
            "2=constant:force=3e-5",
            "1=sine:amplitude=1e-4,period=50",
        ],
    ),
    "gaps that are kept": _flight(
        birds=6,
        t_max=200,
        span_ratios=["5=0.97"],
        forcing=[
            "keeper:gap=0.8/0.5,stiffness=0.02/5e-3",
            "1=keeper:gap=2,stiffness=1e-3,damping=0/1",
        ],
        perturbations=["6@50=-1"],
    ),
    "gaps that are kept over links": _flight(
        birds=5,
        coupling="all",
        t_max=150,
        links=["hold:interval=3,delay=2,drop=0.3,noise=1e-3,timeout=9,seed=4"],
        forcing=["keeper:gap=0.5,stiffness=0.01"],
    ),
    "gusts": _flight(
        birds=5,
        dt=0.5,
        t_max=100,
        forcing=["gust:std=1e-3/2e-3/2e-3,seed=7/7/9", "gust:std=1e-4", "3=gust:std=5e-3,seed=7"],
    ),
    "gusts with memory": _flight(
        birds=7,
        t_max=200,
        span_ratios=["2=1,1.02"],
        forcing=["gust:std=1e-3,time=20/0.3,seed=1", "5=gust:std=2e-3,time=1e6,seed=2"],
    ),
}
"""Each golden flight by its name."""


def digest_of(states: Iterable[FlockState]) -> str:
    """Return the digest of the recorded states of a flight."""
    digest = StateDigest()
    for state in states:
        digest.add(state)
    return digest.hexdigest()


def golden_digest(name: str) -> str:
    """Fly a golden flight in one loop. Return its digest."""
    return digest_of(Reference(FLIGHTS[name]).fly())


def committed_digests() -> dict[str, str]:
    """Return the committed digest of each golden flight, by its name."""
    digests: dict[str, str] = json.loads(DIGESTS.read_text(encoding="utf-8"))
    return digests

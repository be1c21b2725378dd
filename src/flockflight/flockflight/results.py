# SPDX-License-Identifier: Apache-2.0
"""Results without flying, as arrays whose first dimension is the flock, and as datasets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.errors import FlockError, nearest
from flock_sim.physics.flock import Flock
from flock_sim.response.linear_response import linear_response
from flock_sim.theory.delayed.linearisation import MODELS
from flock_tools.experiments.sweep.dataset import ATTRIBUTES as OF_FLIGHTS
from flock_tools.experiments.sweep.dataset import BIRD, GAP, Values, labelled, put
from flock_tools.runs.dataset import LATERAL_SIGN, attributes_of

if TYPE_CHECKING:
    import pandas as pd

Computation = Callable[[FlockConfiguration], Values]

MEMBER, TIME = "member", "time"

BETWEEN = {"span": (0.5, 1.5), "thrust": (0.0, 2.0)}
"""What limits can be of, and the interval that is searched unless one is given."""

ATTRIBUTES = {
    **{name: OF_FLIGHTS[name] for name in (BIRD, GAP, "mean_drag_reduction")},
    MEMBER: ("flock: one of the values that were given for a bird, a link or a force", "1"),
    "exists": ("whether a steady state exists", "1"),
    "stable": ("whether it exists and small disturbances decay", "1"),
    "speed": ("speed U* of all birds in steady flight", "U_min"),
    "spacing": ("streamwise position of bird i + 1 from bird i", "b"),
    "share": ("interaction drag of the pair over its largest value, D/C", "1"),
    "margin": ("distance from the end of existence; below 0: no steady state", "1"),
    "drag_reduction": ("drag saved, over that of the standard bird at cruise", "1"),
    "weakest_gap": ("gap nearest to opening, or that opens; 0: none", "1"),
    "leading_eigenvalue_real": ("growth rate of the disturbance that decays last", "U_min/b"),
    "leading_eigenvalue_imag": ("angular frequency of that disturbance", "U_min/b"),
    "position": ("streamwise position of the bird, from the leader", "b"),
    "lateral": ("lateral position of the bird, from the leader", "b"),
    "span_ratio": ("wing span over that of the standard bird", "1"),
    "speed_gain_peak": ("largest gain from the leader's speed to the bird's", "1"),
    "speed_gain_frequency": ("its angular frequency", "U_min/b"),
    "neighbour_gain_peak": (
        "largest gain from the speed of the neighbour nearer to the leader",
        "1",
    ),
    "neighbour_gain_frequency": ("its angular frequency", "U_min/b"),
    "hinf_gaps": ("H-infinity norm from accelerations of all birds to all gaps", "b^2/U_min^2"),
    "hinf_gaps_frequency": ("its angular frequency", "U_min/b"),
    "hinf_gaps_from_leader": ("H-infinity norm from the leader's acceleration", "b^2/U_min^2"),
    "hinf_gaps_from_leader_frequency": ("its angular frequency", "U_min/b"),
    "gap_std": ("standard deviation of the gap in gusts", "b"),
    "bird_speed_std": ("standard deviation of the bird's speed in gusts", "U_min"),
    "mean_speed_std": ("standard deviation of the mean speed in gusts", "U_min"),
    "speed_spread_rms": ("root mean square of sigma_U in gusts", "U_min"),
    "gap_mean_gibbs": ("mean of the gap in gusts, by the estimate of Gibbs", "b"),
    "gap_std_gibbs": ("standard deviation of the gap, by the same estimate", "b"),
    "modified_bird": ("bird whose span or thrust is modified, all others stay", "1"),
    "lower": ("smallest value with which the flock can fly; nan: below the interval", "1"),
    "upper": ("largest value with which the flock can fly; nan: above the interval", "1"),
    "lower_gap": ("gap that opens below; 0: none", "1"),
    "upper_gap": ("gap that opens above; 0: none", "1"),
    "possible": ("whether the flock can fly with any value in the interval", "1"),
    "best": ("what the order is best in", "1"),
    "order": ("span ratio of the bird at each place of the order", "1"),
    "flies": ("whether the order has a steady state", "1"),
    "proven": ("whether it is proven that no other order is better", "1"),
}
"""Long name and unit of every variable and coordinate."""


def steady_state(configuration: FlockConfiguration) -> Values:
    """Return the steady states of all members, and their stability."""
    from flock_tools.runs.assessment import Assessment

    found = Assessment.of(configuration)
    state = found.state
    values: Values = {
        "exists": state.exists,
        "speed": state.speed,
        "margin": state.margin,
        "weakest_gap": np.array(found.weakest_gap),
        "spacing": state.spacing.T,
        "share": state.share.T,
        "drag_reduction": state.drag_reduction.T,
        "position": state.position.T,
        "lateral": state.lateral.T,
        "span_ratio": state.span_ratio.T,
    }
    if found.eigenvalues is not None:
        values["stable"] = np.array(found.stable)
        values["leading_eigenvalue_real"] = found.eigenvalues[:, 0].real
        values["leading_eigenvalue_imag"] = np.abs(found.eigenvalues[:, 0].imag)
    return values


def responses(lag: float, model: str, gust: float | None) -> Computation:
    """Return the computation of linear responses at steady states, with these arguments."""
    if model not in MODELS:
        raise FlockError(f"link_model = {model!r}: {nearest(str(model), MODELS)}")
    for name, value in (("lag", lag), ("gust", 0.0 if gust is None else gust)):
        if np.ndim(value) or not 0.0 <= float(value) < np.inf:
            raise FlockError(f"{name} = {value}: must be one number, finite, and 0 or more")

    def response(configuration: FlockConfiguration) -> Values:
        found = linear_response(Flock.of(configuration), lag=lag, model=model, gust=gust)
        values = dict(vars(found))
        gusts = values.pop("gust")
        if gusts is not None:
            values |= {name: value for name, value in vars(gusts).items() if name != "std"}
        return values

    return response


def limits(
    configuration: FlockConfiguration,
    birds: int | Iterable[int] | None,
    of: str,
    between: tuple[float, float] | None,
) -> xr.Dataset:
    """Return the exact limits of the span ratios or thrusts of single birds."""
    from flock_sim.theory.span_limits import exact_limits, modified_birds
    from flock_sim.theory.thrust_limits import exact_thrust_limits

    if of not in BETWEEN:
        raise FlockError(f"of = {of!r}: {nearest(str(of), tuple(BETWEEN))}")
    if between is not None and np.shape(between) != (2,):
        raise FlockError(f"between = {between}: must be two numbers, such as {BETWEEN[of]}")
    low, high = BETWEEN[of] if between is None else map(float, between)
    if not 0.0 <= low < high < np.inf:
        raise FlockError(f"between = ({low:g}, {high:g}): must be 0 or more, and ascending")
    given = modified_birds(configuration) if birds is None else np.atleast_1d(np.asarray(birds))
    chosen = [one.item() if isinstance(one, np.generic) else one for one in given]
    for bird in chosen:
        if not isinstance(bird, int):
            raise FlockError(f"bird {bird!r}: must be a whole number from 1")
        if bird not in range(1, configuration.birds + 1):
            raise FlockError(f"bird {bird} is not among 1..{configuration.birds}")
    search = exact_limits if of == "span" else exact_thrust_limits
    found = search(configuration, chosen, low, high)
    values: Values = {"possible": np.array([not one.never for one in found])}
    for side in ("lower", "upper"):
        ends = [getattr(one, side) for one in found]
        values[side] = np.array([np.nan if end is None else end.ratio for end in ends])
        gaps = [0 if end is None or end.gap is None else end.gap for end in ends]
        values[f"{side}_gap"] = np.array(gaps)
    axes = {"modified_bird": xr.Variable("modified_bird", chosen)}
    return dataset(
        [(range(len(chosen)), values)],
        configuration.birds,
        axes,
        {**attributes_of(configuration), "of": of, "between": [low, high]},
    )


def arrangement(configuration: FlockConfiguration) -> xr.Dataset:
    """Return the best orders of the birds of a flock: in speed, and in margin."""
    from flock_sim.theory.arrangement.arrange import arrange

    found = arrange(configuration, configuration.span_ratio[:, 0])
    best = {
        "fastest": found.fastest,
        "fastest that flies": found.fastest_flying,
        "firmest": found.firmest if found.firmest is not None else found.closest,
    }
    known = {name: one for name, one in best.items() if one is not None}
    orders = list(known.values())
    values: Values = {
        "order": np.array([one.order for one in orders]),
        "speed": np.array([one.speed for one in orders]),
        "margin": np.array([one.margin for one in orders]),
        "mean_drag_reduction": np.array([one.saving for one in orders]),
        "flies": np.array([one.flies for one in orders]),
        "proven": np.array([one.proven for one in orders]),
    }
    return dataset(
        [(range(len(orders)), values)],
        configuration.birds,
        {"best": xr.Variable("best", list(known))},
        {**attributes_of(configuration), "orders": found.orders, "method": found.method},
    )


def check_undisturbed(configuration: FlockConfiguration, what: str) -> None:
    """Raise FlockError if a flock has links or forces that the theory does not know."""
    remedy = "leave them out, or fly with them: run() or fly()"
    if not configuration.link_table.plain:
        raise FlockError(
            f"links {' '.join(configuration.links)}: {what} solves the exact coupling; {remedy}"
        )
    if configuration.forcing:
        raise FlockError(
            f"forcing {' '.join(configuration.forcing)}: {what} solves the flight without forces "
            f"besides thrust and drag; {remedy}"
        )


def dataset(
    parts: Iterable[tuple[Sequence[int], Values]],
    birds: int,
    axes: Mapping[str, xr.Variable],
    about: Mapping[str, Any],
) -> xr.Dataset:
    """Return the dataset of several parts: the indices of its flocks, and their values.

    `axes` are its dimensions besides bird and gap, and `about` its attributes.
    """
    size = math.prod(len(axis) for axis in axes.values())
    together: Values = {}
    for members, values in parts:
        put(together, size, members, values)
    found = labelled(together, birds, axes, ATTRIBUTES)
    if "lateral" in found:
        found.lateral.attrs["comment"] = LATERAL_SIGN
    found.attrs = {**about}
    return found


def table(result: xr.Dataset, *names: str) -> pd.DataFrame:
    """Return results as a table, one row for each combination of their coordinates.

        ff.table(flock.equilibrium(), "drag_reduction", "lateral")
        ff.table(flock.sweep({"link.delay": [0, 10, 20]}).run())

    Without `names` its columns are the variables of the axes of a sweep, without those of single
    birds or gaps; for one flock, the variables of birds.
    """
    if not isinstance(result, xr.Dataset):
        raise FlockError(f"{result!r} is no result: compute one, such as by run() or equilibrium()")
    if not names:
        common = {dim for dim in result.sizes if dim not in (BIRD, GAP, TIME)}
        for dims in (common, common | {BIRD}, common | {BIRD, TIME}):
            chosen = [name for name in result.data_vars if dims and set(result[name].dims) == dims]
            if chosen:
                break
        names = tuple(map(str, chosen)) or tuple(map(str, result.data_vars))
    for name in names:
        if name not in result:
            raise FlockError(f"{name!r}: {nearest(name, [str(each) for each in result.data_vars])}")
    return result[list(names)].to_dataframe().reset_index()

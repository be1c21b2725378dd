# SPDX-License-Identifier: Apache-2.0
"""Flocks, and sweeps over their parameters, from Python values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from flock_sim.configuration.flock_configuration import KEYS, LISTS, FlockConfiguration
from flock_sim.errors import FlockError, nearest
from flock_sim.links.keys import KEYS as LINK_KEYS
from flock_tools.experiments.sweep import specification
from flock_tools.experiments.sweep.dataset import coordinates
from flock_tools.runs.dataset import attributes_of
from flockflight import flights, results
from flockflight.values import Force, Link, Push, Spans, span_texts, texts

BIRDS = 13
"""Number of birds of a flock unless it is given."""

LISTED = {"span_ratios": "spans", "perturbations": "pushes"}
"""Keys of a configuration that have another name here."""


class Flock:
    """A flock and its flight.

        Flock()                                            # thirteen equal geese
        Flock(7, coupling="all", t_max=1e5)
        Flock(spans={3: 0.98, 11: 0.98})                   # two smaller birds
        Flock(spans={4: np.linspace(0.9, 1.1, 21)})        # 21 members: independent flocks
        Flock(5, links=Link("hold", delay=5), forcing=[Force("gust", std=2e-5)])

    Results have the dimension `member` if any value makes several members.
    """

    def __init__(
        self,
        birds: int | None = None,
        *,
        coupling: str = "nearest",
        spans: Spans = None,
        links: Link | str | Iterable[Link | str] = (),
        forcing: Force | str | Iterable[Force | str] = (),
        pushes: Push | str | Iterable[Push | str] = (),
        **keys: Any,
    ) -> None:
        """Describe a flock of `birds` birds.

        `coupling` is "nearest" or "all". `spans` has the wing spans of birds over the standard
        span: a dictionary by number (from 1, at the end of the left wing), or one value for each
        bird, which then tell `birds`. `links`, `forcing` and `pushes` are one entry or several.
        `keys` are other keys of the configuration file, such as t_max, dt or record_every. A
        verdict needs a t_max of 6791 b/U_min or more, for the standard bird.

        Raises FlockError on a value that is out of range, or an unknown key.
        """
        for key in keys:
            _check_key(key)
        if birds is None:
            rows = (
                None if spans is None or isinstance(spans, Mapping) else len(np.atleast_1d(spans))
            )
            birds = rows or BIRDS
        given = {
            "birds": birds,
            "coupling": coupling,
            "span_ratios": span_texts(spans, birds),
            "links": texts("links", links, Link),
            "forcing": texts("forcing", forcing, Force),
            "perturbations": texts("pushes", pushes, Push),
            **keys,
        }
        self.configuration = FlockConfiguration.given(
            {key: one.item() if isinstance(one, np.generic) else one for key, one in given.items()}
        )
        """The same as the keys of a configuration file."""

    def __repr__(self) -> str:
        flown = self.configuration
        members = f", {flown.members} members" if flown.members > 1 else ""
        entries = [entry for name in LISTS for entry in getattr(flown, name)]
        some = [*entries[:3], *(["..."] if len(entries) > 3 else [])]
        return f"<Flock: {flown.birds} birds, {flown.coupling} coupling{members}" + (
            f": {' '.join(some)}>" if some else ">"
        )

    def sweep(
        self, axes: Mapping[str, npt.ArrayLike | Sequence[str]] | None = None, **keys: Any
    ) -> Sweep:
        """Return this flock with values along axes, such as {"span_ratio[4]": [0.95, 1, 1.05]}.

        Axes are those of a sweep's file (docs/sweep.md): span_ratio[I], position[I], speed[I],
        link.KEY, forcing.LAW.KEY, or a key of the configuration such as coupling, which may be
        an argument too. Nothing is computed yet.
        """
        return Sweep(self, {**(axes or {}), **keys})

    def equilibrium(self) -> xr.Dataset:
        """Return the steady state: existence, speed, spacing, drag saved, stability. Eq. (steady).

        It is exact, and takes milliseconds. Links and forces have to be the default ones.
        """
        return self._computed("equilibrium", results.steady_state)

    def response(
        self, *, lag: float = 0.0, link_model: str = "linear", gust: float | None = None
    ) -> xr.Dataset:
        """Return the linear response at the steady state: gains, H-infinity norms, gusts.

        Birds know their neighbours `lag` (b/U_min) late, and use late states as `link_model`
        says: "linear" or "hold". `gust` is the standard deviation of white accelerations of all
        birds, in U_min per sqrt(b/U_min). docs/response.md explains the results.
        """
        return self._computed("response", results.responses(lag, link_model, gust))

    def limits(
        self,
        birds: int | Iterable[int] | None = None,
        *,
        of: str = "span",
        between: tuple[float, float] | None = None,
    ) -> xr.Dataset:
        """Return the interval of a bird's span ratio in which the flock can fly, exactly.

        `birds` are modified one at a time; None: all that differ by symmetry. `of="thrust"` is
        for T/T_0 instead. `between` is the interval that is searched.
        """
        return results.limits(self._single("limits"), birds, of, between)

    def arrange(self) -> xr.Dataset:
        """Return the best orders of this flock's birds: the fastest, and the firmest."""
        return results.arrangement(self._single("arrange"))

    def run(self, output: flights.Output = None, *, force: bool = False) -> xr.Dataset:
        """Fly in one loop, without ROS 2. Return all recorded states, and the verdict.

        The result equals that of `fly` bit for bit. With `output`, the bag is kept there; `force`
        replaces another one.
        """
        return flights.run(self.configuration, output, force)

    def fly(
        self, output: flights.Output = None, *, force: bool = False, timeout: float = 60.0
    ) -> xr.Dataset:
        """Fly over ROS 2 in this process, every bird a node. Return the same as `run`.

        Raises FlockError if ROS 2 is not here, RunFailed after `timeout` s of standstill.
        """
        return flights.fly(self.configuration, output, force, timeout)

    def _single(self, what: str) -> FlockConfiguration:
        """Return the configuration. Raises FlockError if it is of several members."""
        if self.configuration.members > 1:
            raise FlockError(f"{what} is for one flock, not {self.configuration.members} members")
        results.check_undisturbed(self.configuration, what)
        return self.configuration

    def _computed(self, what: str, computation: results.Computation) -> xr.Dataset:
        flown = self.configuration
        results.check_undisturbed(flown, what)
        members = range(flown.members)
        axis = {results.MEMBER: xr.Variable(results.MEMBER, np.arange(1, flown.members + 1))}
        found = results.dataset(
            [(members, computation(flown))], flown.birds, axis, attributes_of(flown)
        )
        return found.squeeze(results.MEMBER, drop=True) if flown.members == 1 else found


class Sweep:
    """A flock with values along axes. Results have a dimension for each axis.

        flock = Flock(7, links=Link("hold"))
        sweep = flock.sweep({"span_ratio[2]": np.linspace(0.95, 1.05, 41), "link.delay": [0, 5]})
        sweep.run().verdict

    The name of a dimension is that of the axis without brackets and dots, such as span_ratio_2.
    """

    def __init__(self, flock: Flock, axes: Mapping[str, Any]) -> None:
        """Vary `flock` along `axes`. Raises FlockError on an unknown axis.

        Flocks are made, and their values checked, when something is computed.
        """
        given = flock.configuration.parameters()
        given = {key: value for key, value in given.items() if key not in axes}
        values = {name: np.asarray(value).tolist() for name, value in axes.items()}
        self.plan = specification.sweep({"flock": given, "axes": values})
        """The same as the content of a sweep's file."""

    def __repr__(self) -> str:
        axes = " x ".join(f"{axis.name} ({len(axis.values)})" for axis in self.plan.axes)
        return f"<Sweep of {self.plan.size} flocks: {axes}>"

    def equilibrium(self) -> xr.Dataset:
        """Return the steady states of all flocks, as `Flock.equilibrium`."""
        return self._computed("equilibrium", results.steady_state)

    def response(
        self, *, lag: float = 0.0, link_model: str = "linear", gust: float | None = None
    ) -> xr.Dataset:
        """Return the linear responses of all flocks, as `Flock.response`."""
        return self._computed("response", results.responses(lag, link_model, gust))

    def run(self, output: flights.Output = None, *, force: bool = False) -> xr.Dataset:
        """Fly all flocks in one loop each, without ROS 2, on all cores; return their ends.

        With `output`, the results are written to sweep.nc there as they come, and an interrupted
        sweep goes on from them; `force` replaces another sweep. Raises FlockError, which names the
        flock, if one can't be flown.
        """
        return flights.run_all(self.plan, output, force)

    def _computed(self, what: str, computation: results.Computation) -> xr.Dataset:
        parts = []
        for flight in self.plan.flights(self.plan.size):
            results.check_undisturbed(flight.configuration, what)
            parts.append((flight.members, computation(flight.configuration)))
        about = {"configuration": self.plan.text()}
        return results.dataset(parts, self.plan.flock.birds, coordinates(self.plan), about)


def _check_key(key: str) -> None:
    """Raise FlockError, which names the right one, if `key` is no argument of `Flock`."""
    if key in LISTED:
        raise FlockError(f"{key} is called `{LISTED[key]}` here")
    if key in LINK_KEYS:
        raise FlockError(f"{key} is of a link: pass links=Link(MODEL, {key}=...)")
    if key not in KEYS:
        known = [*LISTED.values(), *(name for name in KEYS if name not in LISTED)]
        raise FlockError(f"unknown argument {key!r}: {nearest(key, known)}")

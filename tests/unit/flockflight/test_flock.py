# SPDX-License-Identifier: Apache-2.0
"""The datasets of `flockflight` hold the numbers of the tools, with names, units and axes."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import flockflight as ff
from flock_sim import FlockConfiguration, arrange, exact_limits, exact_thrust_limits
from flock_sim import linear_response as response_of
from flock_sim.physics.flock import Flock
from flock_tools.runs.assessment import Assessment
from support.flights import record

SPANS = {2: [0.97, 1.0, 1.02, 0.7], 4: 1.01}


def described(found: xr.Dataset) -> None:
    for name in found.variables:
        assert found[name].attrs["long_name"], name
        assert found[name].attrs["units"], name


def test_a_steady_state_is_that_of_equilibrium() -> None:
    flock = ff.Flock(5, spans=SPANS)
    found = flock.equilibrium()
    described(found)
    assert dict(found.sizes) == {"member": 4, "gap": 4, "bird": 5}
    known = Assessment.of(flock.configuration)
    assert found.exists.values.tolist() == [True, True, True, False]
    assert found.stable.values.tolist() == known.stable
    np.testing.assert_array_equal(found.speed, known.state.speed)
    np.testing.assert_array_equal(found.spacing, known.state.spacing.T)
    np.testing.assert_array_equal(found.drag_reduction, known.state.drag_reduction.T)
    np.testing.assert_array_equal(found.position, known.state.position.T)
    np.testing.assert_array_equal(found.weakest_gap, known.weakest_gap)
    assert found.attrs["span_ratios"] == "2=0.97,1.0,1.02,0.7 4=1.01"


def test_one_flock_has_no_dimension_of_members() -> None:
    found = ff.Flock(3).equilibrium()
    assert dict(found.sizes) == {"gap": 2, "bird": 3}
    np.testing.assert_allclose(found.spacing, -found.spacing[::-1], rtol=1e-12)  # its mirror image
    alone = ff.Flock(1).equilibrium()
    assert bool(alone.exists)
    assert alone.drag_reduction.item() == 0.0


def test_a_response_is_that_of_response() -> None:
    flock = ff.Flock(4, spans={2: [0.98, 1.01]})
    found = flock.response(lag=5.0, link_model="hold", gust=2e-5)
    described(found)
    known = response_of(Flock.of(flock.configuration), lag=5.0, model="hold", gust=2e-5)
    np.testing.assert_array_equal(found.hinf_gaps, known.hinf_gaps)
    np.testing.assert_array_equal(found.speed_gain_peak, known.speed_gain_peak)
    np.testing.assert_array_equal(found.neighbour_gain_peak, known.neighbour_gain_peak)
    assert known.gust is not None
    np.testing.assert_array_equal(found.gap_std, known.gust.gap_std)
    assert "gap_std" not in flock.response()


def test_limits_are_those_of_limits() -> None:
    configuration = FlockConfiguration(birds=5)
    found = ff.Flock(5).limits()
    described(found)
    assert found.modified_bird.values.tolist() == [1, 2, 3]
    for at, known in enumerate(exact_limits(configuration, [1, 2, 3], 0.5, 1.5)):
        for side, end in (("lower", known.lower), ("upper", known.upper)):
            assert end is not None
            assert found[side][at] == end.ratio
            assert found[f"{side}_gap"][at] == end.gap
    thrust = ff.Flock(5).limits(2, of="thrust", between=(0.99, 2.0))
    (known,) = exact_thrust_limits(configuration, [2], 0.99, 2.0)
    assert known.lower is None
    assert known.upper is not None
    assert np.isnan(thrust.lower.item())
    assert thrust.lower_gap.item() == 0
    assert thrust.upper.item() == known.upper.ratio


def test_orders_are_those_of_arrange() -> None:
    spans = [1.0, 1.05, 0.95, 1.02, 0.99]
    found = ff.Flock(spans=spans).arrange()
    described(found)
    known = arrange(FlockConfiguration(birds=5), np.array(spans))
    assert known.firmest is not None
    firmest = found.sel(best="firmest")
    np.testing.assert_array_equal(firmest.order, known.firmest.order)
    assert firmest.margin == known.firmest.margin
    assert sorted(found.sel(best="fastest").order.values) == sorted(spans)


def test_a_run_is_the_flight_of_reference_to_the_bit(tmp_path: Path) -> None:
    flock = ff.Flock(4, spans={2: [1.0, 0.98]}, t_max=60, record_every=4, links=ff.Link("hold"))
    found = flock.run(tmp_path / "kept")
    described(found)
    other = ff.load(record(tmp_path / "other", flock.configuration))
    xr.testing.assert_equal(found, other)
    xr.testing.assert_equal(found, ff.load(tmp_path / "kept"))
    assert ff.compare(tmp_path / "kept", tmp_path / "other").equal
    assert ff.load(tmp_path / "kept", start=8, end=24, stride=2).step.values.tolist() == [8, 16, 24]


def test_a_run_replaces_another_on_request_only(tmp_path: Path) -> None:
    flock, other = ff.Flock(2, t_max=30), ff.Flock(3, t_max=30)
    flock.run(tmp_path / "run")
    with pytest.raises(ff.FlockError, match="exists: pass force=True to replace it"):
        other.run(tmp_path / "run")
    assert ff.load(tmp_path / "run").sizes["bird"] == 2
    other.run(tmp_path / "run", force=True)
    assert ff.load(tmp_path / "run").sizes["bird"] == 3
    flock.sweep({"span_ratio[2]": [1.0, 1.01]}).run(tmp_path / "sweep")
    longer = ff.Flock(2, t_max=60).sweep({"span_ratio[2]": [1.0, 1.01]})
    with pytest.raises(ff.FlockError, match=r"differs\): pass force=True"):
        longer.run(tmp_path / "sweep")
    longer.run(tmp_path / "sweep", force=True)


def test_a_sweep_runs_each_flock_as_it_runs_alone() -> None:
    flock = ff.Flock(4, t_max=200, links=ff.Link("hold"), forcing=ff.Force("gust", std=1e-5))
    found = flock.sweep({"link.delay": [0, 4], "span_ratio[2]": [0.98, 1.0]}).run()
    described(found)
    for delay in (0, 4):
        for ratio in (0.98, 1.0):
            alone = ff.Flock(
                4,
                spans={2: ratio},
                t_max=200,
                links=ff.Link("hold", delay=delay),
                forcing=ff.Force("gust", std=1e-5),
            ).run()
            point = found.sel(link_delay=delay, span_ratio_2=ratio)
            np.testing.assert_array_equal(point.position, alone.position[-1])
            np.testing.assert_array_equal(point.drag_reduction, alone.drag_reduction[-1])
            assert point.verdict.item() == alone.verdict.item() == "settling"
            assert "too short" in alone.verdict_reason.item()


def test_a_run_has_the_drag_saved_and_the_verdict() -> None:
    flock = ff.Flock(5, t_max=40_000, record_every=100)
    found, steady = flock.run(), flock.equilibrium()
    assert dict(found.sizes) == {"time": 401, "bird": 5}
    assert found.verdict.item() == "holds"
    np.testing.assert_allclose(found.drag_reduction[-1], steady.drag_reduction, rtol=1e-6)
    np.testing.assert_allclose(found.speed[-1], steady.speed, rtol=1e-9)


def test_a_sweep_has_its_axes_as_coordinates() -> None:
    flock = ff.Flock(5, t_max=100, spans={4: 1.01})
    sweep = flock.sweep({"span_ratio[2]": np.linspace(0.97, 1.03, 3)}, coupling=["nearest", "all"])
    assert repr(sweep) == "<Sweep of 6 flocks: span_ratio[2] (3) x coupling (2)>"
    found = sweep.equilibrium()
    described(found)
    assert found.speed.dims == ("span_ratio_2", "coupling")
    assert found.spacing.dims == ("span_ratio_2", "coupling", "gap")
    for ratio in found.span_ratio_2.values:
        for coupling in ("nearest", "all"):
            point = found.sel(span_ratio_2=ratio, coupling=coupling)
            alone = ff.Flock(5, spans={2: ratio, 4: 1.01}, coupling=coupling).equilibrium()
            for name in alone.data_vars:
                np.testing.assert_allclose(point[name], alone[name], rtol=1e-9, err_msg=str(name))
    gains = sweep.response()
    assert gains.hinf_gaps.dims == ("span_ratio_2", "coupling")
    described(gains)


def test_theory_refuses_what_it_does_not_know() -> None:
    late, windy = ff.Flock(links=ff.Link("hold", delay=3)), ff.Flock(forcing="gust:std=1e-5")
    for what in ("equilibrium", "response", "limits", "arrange"):
        with pytest.raises(ff.FlockError, match=rf"{what} solves the exact coupling; leave them"):
            getattr(late, what)()
        with pytest.raises(ff.FlockError, match=rf"{what} solves the flight without forces"):
            getattr(windy, what)()
    with pytest.raises(ff.FlockError, match="equilibrium solves the exact coupling"):
        ff.Flock().sweep({"link.delay": [0, 3]}).equilibrium()


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: ff.Flock(5, spans=SPANS).limits(), "limits is for one flock, not 4 members"),
        (lambda: ff.Flock(5, spans=SPANS).arrange(), "arrange is for one flock, not 4 members"),
        (lambda: ff.Flock().limits(of="spam"), "did you mean 'span'"),
        (lambda: ff.Flock().limits([1, 14]), "bird 14 is not among 1..13"),
        (lambda: ff.Flock().limits(between=(1.2, 0.8)), r"between = \(1.2, 0.8\)"),
        (lambda: ff.Flock().response(lag=-1.0), "lag = -1.0: must be one number, finite, and 0"),
        (lambda: ff.Flock().response(lag=np.array([0, 1])), r"lag = \[0 1\]: must be one number"),
        (lambda: ff.Flock().limits(2.5), "bird 2.5: must be a whole number"),
        (lambda: ff.Flock().limits("3"), "bird '3': must be a whole number"),
        (lambda: ff.Flock().limits(between=0.5), "between = 0.5: must be two numbers"),
        (lambda: ff.table(ff.Flock()), "is no result: compute one"),
        (lambda: ff.Flock().sweep({"delay": [0, 1]}), "did you mean 'link.delay'"),
        (lambda: ff.Flock().response(gust=np.nan), "gust = nan"),
        (lambda: ff.Flock().response(link_model="hodl"), "did you mean 'hold'"),
        (lambda: ff.Flock().sweep({"span_ratoi[2]": [1]}), "span_ratio"),
        (lambda: ff.Flock().sweep(), "must hold one or more"),
        (lambda: ff.Flock(3).run("/proc/no/such"), "/proc/no"),
        (lambda: ff.table(ff.Flock(3).equilibrium(), "sped"), "did you mean 'speed'"),
    ],
)
def test_what_was_meant_is_named(call: object, told: str) -> None:
    with pytest.raises(ff.FlockError, match=told):
        call()  # type: ignore[operator]


def test_lateral_says_which_side_is_negative() -> None:
    lateral = ff.Flock(3).equilibrium().lateral
    assert lateral.sel(bird=1) < 0.0
    assert "negative on the left wing, where bird 1 flies" in lateral.attrs["comment"]


def test_a_table_has_a_row_for_each_bird_or_each_point_of_a_sweep() -> None:
    flock = ff.Flock(3)
    birds = ff.table(flock.equilibrium())
    assert birds.bird.tolist() == [1, 2, 3]
    assert list(birds.columns) == ["bird", "drag_reduction", "position", "lateral", "span_ratio"]
    points = ff.table(flock.sweep({"span_ratio[2]": [0.99, 1.0]}).equilibrium())
    assert points.span_ratio_2.tolist() == [0.99, 1.0]
    assert {"exists", "speed", "margin", "stable"} <= set(points.columns)
    assert list(ff.table(flock.equilibrium(), "speed", "spacing").columns) == [
        "gap",
        "speed",
        "spacing",
    ]


def test_a_picture_is_that_of_the_run(tmp_path: Path) -> None:
    ff.Flock(5, t_max=100, spans={2: [1, 0.98]}).run(tmp_path / "run")
    figure = ff.picture(tmp_path / "run", at=50, member=2)
    assert "t = 50" in "".join(text.get_text() for text in figure.texts)
    with pytest.raises(ff.FlockError, match="member = 3: must be from 1 to 2"):
        ff.picture(tmp_path / "run", member=3)


def test_results_can_be_written_as_netcdf(tmp_path: Path) -> None:
    for number, found in enumerate(
        (ff.Flock(3).equilibrium(), ff.Flock(3).limits(), ff.Flock(3, t_max=50).run())
    ):
        found.to_netcdf(tmp_path / f"{number}.nc", engine="scipy")
        with xr.open_dataset(tmp_path / f"{number}.nc", engine="scipy") as read:
            assert set(read.data_vars) == set(found.data_vars)

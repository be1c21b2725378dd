# SPDX-License-Identifier: Apache-2.0
"""A dataset equals the run bit for bit, and describes its numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from flock_sim.configuration.flock_configuration import LISTS, FlockConfiguration
from flock_sim.errors import FlockError
from flock_sim.messages.state import ARRAYS
from flock_sim.recording.run import Run
from flock_tools.runs import dataset
from flock_tools.runs.dataset import load
from support.flights import record

CONFIGURATION = FlockConfiguration(
    birds=4, dt=0.5, t_max=40.0, record_every=2, span_ratios=("2=1.0,1.02,0.97", "4=1.01")
)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flight") / "run", CONFIGURATION)


@pytest.mark.parametrize("block", [1, 7, dataset.BLOCK])
def test_a_dataset_is_the_run_to_the_bit(
    flight: Path, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataset, "BLOCK", block)
    data = load(flight)
    assert dict(data.sizes) == {"time": 41, "bird": 4, "member": 3}
    with Run(flight) as run:
        snapshots = list(run.snapshots())
    for row, snapshot in enumerate(snapshots):
        assert data.time[row] == snapshot.time
        assert data.step[row] == snapshot.step
        for name in ARRAYS:
            values = data[name].transpose("time", "bird", "member")[row]
            assert values.to_numpy().tobytes() == getattr(snapshot, name).tobytes()


def test_a_dataset_knows_the_flock(flight: Path) -> None:
    data = load(flight)
    assert data.bird.to_numpy().tolist() == [1, 2, 3, 4]
    assert data.member.to_numpy().tolist() == [1, 2, 3]
    np.testing.assert_array_equal(data.span_ratio, CONFIGURATION.span_ratio)
    with Run(flight) as run:
        np.testing.assert_array_equal(data.lateral.T, run.metrics().lateral)
    assert data.attrs["span_ratios"] == "2=1.0,1.02,0.97 4=1.01"
    assert data.attrs["perturbations"] == "none"
    assert data.attrs["links"] == "none"
    assert data.attrs["leader"] == 3
    parameters = CONFIGURATION.parameters()
    for key in LISTS:
        del parameters[key]
    assert data.attrs.items() >= parameters.items()


def test_everything_has_a_name_and_a_unit(flight: Path) -> None:
    data = load(flight)
    for name in data.variables:
        assert data[name].attrs["long_name"]
        assert data[name].attrs["units"]
    assert data.speed.attrs["units"] == "U_min"
    assert data.circulation.attrs["symbol"] == "Gamma_i"


def test_lateral_says_which_side_is_negative(flight: Path) -> None:
    lateral = load(flight).lateral
    assert (lateral.sel(bird=1) < 0.0).all()
    assert "negative on the left wing, where bird 1 flies" in lateral.attrs["comment"]
    assert "-lateral * b" in lateral.attrs["comment"]


@pytest.mark.parametrize(
    ("choice", "times"),
    [
        ({"start": 3.0, "end": 5.0}, [3.0, 4.0, 5.0]),
        ({"start": 2.5, "end": 5.9}, [3.0, 4.0, 5.0]),
        ({"end": 2.0}, [0.0, 1.0, 2.0]),
        ({"start": 39.0}, [39.0, 40.0]),
        ({"start": -5.0, "end": 1000.0, "stride": 16}, [0.0, 16.0, 32.0]),
        ({"start": 7.0, "end": 7.0}, [7.0]),
    ],
)
def test_a_part_is_that_part_of_the_whole(flight: Path, choice: dict, times: list[float]) -> None:
    part = load(flight, **choice)
    assert part.time.to_numpy().tolist() == times
    judged = ["verdict", "verdict_reason"]  # on the flight up to the last time of the part
    whole = load(flight).sel(time=times)
    xr.testing.assert_identical(part.drop_vars(judged), whole.drop_vars(judged))
    with Run(flight) as run:
        verdicts = run.verdicts(times[-1])
    assert part.verdict.to_numpy().tolist() == verdicts.verdict
    assert part.verdict_reason.to_numpy().tolist() == verdicts.verdict_reason


@pytest.mark.parametrize(
    "choice",
    [{"start": 41.0}, {"end": -1.0}, {"start": 5.0, "end": 3.0}, {"start": 3.2, "end": 3.8}]
    + [{"start": float("nan")}, {"end": float("inf")}, {"stride": 0}],
)
def test_no_time_at_all_is_refused(flight: Path, choice: dict) -> None:
    with pytest.raises(FlockError):
        load(flight, **choice)


def test_a_dataset_survives_netcdf(flight: Path, tmp_path: Path) -> None:
    data = load(flight)
    data.to_netcdf(tmp_path / "run.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "run.nc", engine="scipy") as read:
        xr.testing.assert_equal(read, data)
        assert read.attrs.keys() == data.attrs.keys()


def test_a_bag_cut_short_ends_with_its_last_complete_step(tmp_path: Path) -> None:
    path = record(
        tmp_path / "run",
        CONFIGURATION,
        lambda bird, state: None if state.time > 20.0 - bird else state,
    )
    (path / "metadata.yaml").unlink()
    data = load(path)
    assert data.time[-1] == 16.0
    assert np.isfinite(data.position).all()
    assert "not complete" in data.attrs["missing"]


def test_states_of_another_shape_are_refused(tmp_path: Path) -> None:
    path = record(
        tmp_path / "run",
        CONFIGURATION,
        lambda bird, state: replace(state, frame="map") if state.step == 4 else state,
    )
    with pytest.raises(FlockError, match="not as Flock writes it"):
        load(path)

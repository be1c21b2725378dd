# SPDX-License-Identifier: Apache-2.0
"""The Python examples of a document run with the pinned packages."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest
import xarray as xr
from markdown_it import MarkdownIt
from matplotlib import pyplot
from matplotlib.colors import LogNorm

DOCS = Path(__file__).parents[3] / "docs"


def python_of(document: str) -> str:
    """Return the Python code of a document, whose blocks are fenced as `python`."""
    tokens = MarkdownIt().parse((DOCS / document).read_text(encoding="utf-8"))
    assert not [token for token in tokens if token.type == "code_block"]
    return "\n".join(token.content for token in tokens if token.info == "python")


def test_the_dataset_of_a_sweep_is_drawn_as_the_document_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "runs" / "delays").mkdir(parents=True)
    spread = (("span_ratio_2", "link_delay"), np.logspace(-16.0, -1.0, 12).reshape(3, 4))
    axes = {"span_ratio_2": [0.9, 1.0, 1.1], "link_delay": [0, 1, 2, 3]}
    dataset = xr.Dataset({"speed_std": spread}, axes)
    dataset.to_netcdf(tmp_path / "runs" / "delays" / "sweep.nc", engine="scipy")
    monkeypatch.chdir(tmp_path)
    matplotlib.use("agg")
    code = python_of("sweep.md")
    assert "open_dataset" in code
    try:
        exec(compile(code, "docs/sweep.md", "exec"), {})
        (mesh,) = pyplot.gca().collections
        assert isinstance(mesh.norm, LogNorm)
        assert (mesh.norm.vmin, mesh.norm.vmax) == (1e-16, 0.1)
    finally:
        pyplot.close("all")

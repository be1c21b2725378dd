# SPDX-License-Identifier: Apache-2.0
"""The Python code of docs/python.md runs, and the page names all that is public."""

import importlib.util
import re
from pathlib import Path

import pytest

import flock_sim
import flock_tools
import flockflight

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python.md"


def test_the_code_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code = "\n".join(
        re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    )
    if importlib.util.find_spec("pyarrow") is None:
        code = re.sub(r"^.*to_parquet.*$", "", code, flags=re.MULTILINE)
    names: dict[str, object] = {}
    exec(compile(code, str(PAGE), "exec"), names)
    assert (tmp_path / "sweep.nc").stat().st_size
    assert (tmp_path / "sweep.csv").read_text().startswith("span_ratio_7,exists,speed,margin,")
    assert names["run"].verdict.item() in ("holds", "settling")  # type: ignore[attr-defined]


@pytest.mark.parametrize("package", [flock_sim, flock_tools, flockflight])
def test_every_public_name_is_on_the_page(package: object) -> None:
    text = PAGE.read_text()
    name = package.__name__  # type: ignore[attr-defined]
    for public in package.__all__:  # type: ignore[attr-defined]
        known = (f"{one}.{public}" for one in (name, "flock_sim", "flock_tools", "flockflight"))
        assert any(re.search(rf"{re.escape(one)}\b", text) for one in known), public

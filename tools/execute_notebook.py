# SPDX-License-Identifier: Apache-2.0
"""Executes the notebook of examples/ and writes it with its outputs: execute_notebook.py [OUTPUT].

Run it by the Python of an environment with `pip install ".[notebook]"`, in an empty directory. The
notebook is replaced unless OUTPUT is given.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbclient
import nbformat

NOTEBOOK = Path(__file__).resolve().parents[1] / "examples" / "gusty_formation.ipynb"


def main() -> None:
    """Execute the notebook."""
    notebook = nbformat.read(NOTEBOOK, 4)
    client = nbclient.NotebookClient(
        notebook, timeout=600, kernel_name="python3", record_timing=False, coalesce_streams=True
    )
    client.execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            # The page of the site shows text, and the markup differs from version to version.
            output.get("data", {}).pop("text/html", None)
    notebook.metadata = {key: notebook.metadata[key] for key in ("kernelspec",)}
    nbformat.write(notebook, sys.argv[1] if len(sys.argv) > 1 else NOTEBOOK)


if __name__ == "__main__":
    main()

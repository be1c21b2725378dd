# SPDX-License-Identifier: Apache-2.0
"""Scripts that are run in a Python process of their own."""

import subprocess
import sys
from collections.abc import Mapping


def python(script: str, *arguments: str, environment: Mapping[str, str] | None = None) -> str:
    """Run `script` without the working directory on its path. Return what it prints on stdout."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", script, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout

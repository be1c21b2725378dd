# SPDX-License-Identifier: Apache-2.0
"""Compute the digests of the golden flights, and compare them with the committed ones.

    ./flock python tests/golden.py [--write]

Prints each digest, and exits 1 if one differs. `--write` writes them to the tree instead: read
`support/golden_flights.py` on what that means for users.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys

from numba.core.registry import cpu_target

from support.golden_flights import DIGESTS, FLIGHTS, committed_digests, golden_digest


def main() -> int:
    """Compute, write if asked to, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the digests to the tree")
    options = parser.parse_args()

    digests = {name: golden_digest(name) for name in FLIGHTS}
    if options.write:
        DIGESTS.write_text(json.dumps(digests, indent=2) + "\n", encoding="utf-8")
    committed = committed_digests()
    equal = {name: committed.get(name) == digest for name, digest in digests.items()}
    for name, digest in digests.items():
        print(digest, "equal  " if equal[name] else "DIFFERS", name)
    processor = cpu_target.target_context.codegen().magic_tuple()[1]  # that numba compiles for
    machine = f"{platform.machine()} ({processor}) with {' '.join(platform.libc_ver())}"
    print(f"{sum(equal.values())} of {len(equal)} golden flights are equal on {machine}")
    return 0 if all(equal.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

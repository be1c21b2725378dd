# SPDX-License-Identifier: Apache-2.0
"""The machine on which a flight was recorded: what can change the last bits of a computation."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Self

from flock_sim import __version__

NAMES = {
    "python": "Python",
    "numpy": "NumPy",
    "numba": "numba",
    "llvmlite": "llvmlite",
    "flock": "Flock",
    "ros_distribution": "ROS 2",
}
"""The words before the values of facts in a text. Other values need none."""

LONGEST = 200
"""Number of characters of a fact that are shown."""

_CPU_INFORMATION = Path("/proc/cpuinfo")


@dataclass(frozen=True)
class Machine:
    """Processor and software; None for unknown facts, and for ROS where it was not used.

    No fact names the host, its users or its directories.
    """

    processor: str | None
    architecture: str | None
    operating_system: str | None
    c_library: str | None
    python: str | None
    numpy: str | None
    numba: str | None
    llvmlite: str | None
    flock: str | None
    ros_distribution: str | None = None
    rmw: str | None = None

    @classmethod
    def of(cls, record: Mapping[str, str]) -> Self:
        """Return the machine in a metadata record, whose texts may come from anywhere."""
        return cls(**{field.name: _shown(record.get(field.name)) for field in fields(cls)})

    def record(self) -> dict[str, str]:
        """Return the known facts as a metadata record."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    def told(self, *names: str) -> str:
        """Return the known facts as text; with `names` only these."""
        return ", ".join(
            f"{NAMES.get(name, '')} {value}".strip()
            for name, value in self.record().items()
            if not names or name in names
        )


def differing(machines: Iterable[Machine]) -> list[str]:
    """Return the names of those facts for which two machines have different known values."""
    records = [machine.record() for machine in machines]
    values = {
        field.name: {record[field.name] for record in records if field.name in record}
        for field in fields(Machine)
    }
    return [name for name, found in values.items() if len(found) > 1]


def this_machine(ros_distribution: str | None = None, rmw: str | None = None) -> Machine:
    """Return the machine of this process; the arguments tell of ROS, where it is used."""
    return Machine(
        processor=_processor(),
        architecture=platform.machine() or None,
        operating_system=_operating_system(),
        c_library=_c_library(),
        python=platform.python_version(),
        numpy=_version("numpy"),
        numba=_version("numba"),
        llvmlite=_version("llvmlite"),
        flock=__version__,
        ros_distribution=ros_distribution,
        rmw=rmw,
    )


def _shown(text: str | None) -> str | None:
    """Return a text without control characters, and of limited length."""
    return text and "".join(c if c.isprintable() else "?" for c in text[:LONGEST])


def _processor() -> str | None:
    """Return the model of the processor; on Arm its implementer and part, as Linux has no name."""
    try:
        lines = _CPU_INFORMATION.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or None
    facts: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        facts.setdefault(name.strip(), value.strip())
    if model := facts.get("model name"):
        return model
    names = "CPU implementer", "CPU part"
    return ", ".join(f"{name} {facts[name]}" for name in names if name in facts) or None


def _operating_system() -> str | None:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME") or platform.system() or None
    except OSError:
        return platform.system() or None


def _c_library() -> str | None:
    try:
        return os.confstr("CS_GNU_LIBC_VERSION")
    except (ValueError, OSError):  # not glibc
        return " ".join(filter(None, platform.libc_ver())) or None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None

# SPDX-License-Identifier: Apache-2.0
"""The machine of a recording: what its texts hold, and what they never hold."""

import getpass
import os
import platform
import socket
from dataclasses import asdict, fields, replace
from importlib.metadata import version
from pathlib import Path

import pytest

from flock_sim import __version__
from flock_sim.recording import machine
from flock_sim.recording.machine import LONGEST, Machine, differing, this_machine

ARM = "processor\t: 0\nCPU implementer\t: 0x41\nCPU part\t: 0xd0c\n\nprocessor\t: 1\n"


def test_this_machine_has_all_facts_that_may_change_a_bit() -> None:
    here = this_machine()
    assert here.architecture == platform.machine()
    assert here.python == platform.python_version()
    assert (here.numpy, here.numba) == (version("numpy"), version("numba"))
    assert (here.llvmlite, here.flock) == (version("llvmlite"), __version__)
    assert here.c_library is not None
    assert here.c_library.split()[0] in ("glibc", "musl")
    assert None not in (here.processor, here.operating_system)
    assert (here.ros_distribution, here.rmw) == (None, None)


def test_no_fact_names_the_host_its_users_or_its_directories() -> None:
    told = list(this_machine().record().values())
    assert not [text for text in told if os.sep in text.replace("GNU/Linux", "")]
    words = {word for text in told for word in text.split()}
    assert words.isdisjoint({socket.gethostname(), platform.node(), getpass.getuser()})


def test_the_processor_of_an_arm_machine_is_its_implementer_and_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    information = tmp_path / "cpuinfo"
    information.write_text(ARM)
    monkeypatch.setattr(machine, "_CPU_INFORMATION", information)
    assert this_machine().processor == "CPU implementer 0x41, CPU part 0xd0c"


def test_a_record_has_the_known_facts_only() -> None:
    here = this_machine()
    assert set(here.record()) == {name for name, value in asdict(here).items() if value}
    assert Machine.of(here.record()) == here
    assert Machine.of({}) == Machine(**dict.fromkeys(field.name for field in fields(Machine)))


def test_texts_from_a_foreign_bag_are_harmless() -> None:
    read = Machine.of({"processor": "\x1b[2J\nx", "python": 1000 * "3", "more": "y"})
    assert read.processor == "?[2J?x"
    assert read.python == LONGEST * "3"


def test_a_machine_in_words_has_the_names_of_versions() -> None:
    here = Machine("CPU", "x86_64", None, "glibc 2.36", *"34567", "jazzy", "rmw_x")
    assert here.told("processor", "numpy") == "CPU, NumPy 4"
    assert here.told() == (
        "CPU, x86_64, glibc 2.36, Python 3, NumPy 4, numba 5, llvmlite 6, Flock 7, ROS 2 jazzy, "
        "rmw_x"
    )


def test_unknown_facts_do_not_differ() -> None:
    one = this_machine()
    other = replace(one, rmw="rmw_x", numpy="1.0", processor="another")
    assert differing([one, other]) == ["processor", "numpy"]
    assert differing([one]) == differing([]) == []

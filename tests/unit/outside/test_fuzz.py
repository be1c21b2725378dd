# SPDX-License-Identifier: Apache-2.0
"""Whatever a file contains, it is read or refused: no other exception than FlockError.

`make fuzz` sets FLOCK_FUZZ, the number of parameter files and of sweep files.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random

import pytest

from flock_sim.bag.directory import METADATA_FILE
from flock_sim.bag.reading.listing import listing
from flock_sim.configuration import parameter_file
from flock_sim.configuration.flock_configuration import FlockConfiguration
from flock_sim.configuration.operation import parted
from flock_sim.errors import FlockError
from flock_tools.experiments.sweep import specification
from support import random_text_files

FILES = int(os.environ.get("FLOCK_FUZZ", "300"))

NODES = ("/flock/clock", "/flock/bird_03", "/flock/recorder")

METADATA = """\
rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  duration:
    nanoseconds: 4166666
  starting_time:
    nanoseconds_since_epoch: 0
  message_count: 2
  topics_with_message_count:
    - topic_metadata:
        name: /flock/bird_01/state
        type: flock_interfaces/msg/BirdState
        serialization_format: cdr
        offered_qos_profiles:
          - history: keep_all
            depth: 0
      message_count: 2
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - run_0.mcap
  files:
    - path: run_0.mcap
      message_count: 2
  custom_data: ~
  ros_distro: jazzy
"""


def read_parameters(file: Path) -> None:
    sections = parameter_file.sections(file)
    sections.unmatched(NODES)
    for node in ("", *NODES):
        with suppress(FlockError):
            flown, _ = parted(sections.of(node) if node else sections.common)
            FlockConfiguration.given(flown)


def read_sweep(file: Path) -> None:
    sweep = specification.read(file)
    if sweep.size <= 20:
        sweep.members()


@pytest.mark.parametrize(
    ("make", "read"),
    [
        (random_text_files.parameter_file, read_parameters),
        (random_text_files.sweep_file, read_sweep),
    ],
    ids=["parameter file", "sweep file"],
)
def test_a_random_file_of_a_user_is_read_or_refused(
    make: Callable[[Random], str], read: Callable[[Path], None], tmp_path: Path
) -> None:
    file, refused = tmp_path / "file.yaml", 0
    for seed in range(FILES):
        text = make(Random(seed))
        file.write_text(text, encoding="utf-8", newline="")
        try:
            read(file)
        except FlockError:
            refused += 1
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {error!r} by {text[:2000]!r}") from error
    assert 0.2 * FILES < refused < 0.95 * FILES  # most parts of the readers were reached


def test_a_random_metadata_file_is_read_or_refused(tmp_path: Path) -> None:
    (tmp_path / "run_0.mcap").touch()
    for seed in range(max(FILES // 10, 200)):
        text = random_text_files.metadata_file(Random(seed), METADATA)
        (tmp_path / METADATA_FILE).write_text(text, encoding="utf-8", newline="")
        try:
            found = listing(tmp_path)
        except FlockError:
            continue
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {error!r} by {text[:2000]!r}") from error
        assert [file.name for file in found.files] == ["run_0.mcap"]

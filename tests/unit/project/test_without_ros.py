# SPDX-License-Identifier: Apache-2.0
"""The packages below ROS work without ROS, bags and plots."""

import pytest

from support.python_process import python

IMPORT = """
import importlib, pkgutil, sys

FOLDERS, ABSENT = (argument.split() for argument in sys.argv[1:])

class Absence:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ABSENT or name in ABSENT:
            raise ModuleNotFoundError(f"{FOLDERS} import {name}")

sys.meta_path.insert(0, Absence())

for folder in FOLDERS:
    package = importlib.import_module(f"flock_sim.{folder}")
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
        print(module.name)
"""

ROS = (
    "ament_index_python builtin_interfaces launch launch_ros rclpy rosgraph_msgs rosidl_parser "
    "rosidl_runtime_py rpyutils std_msgs flock_interfaces flock_sim.ros flock_sim.nodes"
)


@pytest.mark.parametrize(
    ("folders", "absent", "one"),
    [
        (
            "physics links messages analysis reference protocol theory",
            f"{ROS} flock_tools mcap rosbags yaml matplotlib xarray flock_sim.bag",
            "flock_sim.protocol.bird",
        ),
        (
            "console configuration bag recording",
            f"{ROS} flock_tools matplotlib xarray numba",
            "flock_sim.recording.run",
        ),
    ],
)
def test_nothing_below_the_floor_of_ros_imports_it(folders: str, absent: str, one: str) -> None:
    assert one in python(IMPORT, folders, absent).split()

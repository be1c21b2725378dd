# SPDX-License-Identifier: Apache-2.0
"""The core runs where there is no ROS, no bag and no plot."""

import subprocess
import sys

IMPORT_THE_CORE = """
import importlib, pkgutil, sys

ABSENT = {
    "ament_index_python", "builtin_interfaces", "launch", "launch_ros", "rclpy", "rosgraph_msgs",
    "rosidl_parser", "rosidl_runtime_py", "rpyutils", "std_msgs", "flock_interfaces",
    "flock_tools", "mcap", "rosbags", "yaml", "matplotlib", "xarray",
}

class Absence:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ABSENT or name.startswith(LATER):
            raise ModuleNotFoundError(f"the core imports {name}")

LATER = ("flock_sim.nodes", "flock_sim.bag", "flock_sim.fly", "flock_sim.reference")
sys.meta_path.insert(0, Absence())

import flock_sim.core as core
names = [module.name for module in pkgutil.walk_packages(core.__path__, "flock_sim.core.")]
for name in names:
    importlib.import_module(name)
print(*names)
"""


def test_the_core_imports_nothing_of_ros_and_nothing_that_comes_after_it():
    ended = subprocess.run(
        [sys.executable, "-c", IMPORT_THE_CORE], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "flock_sim.core.protocol" in ended.stdout.split()

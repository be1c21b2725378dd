# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flock_sim",
    version="0.1.0",
    description="A flock in V-formation, every bird a ROS 2 node.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flock_sim"]),
        ("share/flock_sim", ["package.xml", "machine.xml", "network.xml"]),
        (
            "share/flock_sim/launch",
            ["launch/flock.launch.py", "launch/composed.launch.py"],
        ),
    ],
    entry_points={
        "console_scripts": [
            "bird=flock_sim.nodes.bird:main",
            "clock=flock_sim.nodes.clock:main",
            "recorder=flock_sim.nodes.recorder:main",
            "fly=flock_sim.fly:main",
            "reference=flock_sim.reference:main",
        ],
    },
)

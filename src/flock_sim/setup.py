# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flock_sim",
    version="0.1.0",
    description="Birds in V-formation, each of them a ROS 2 node: physics, nodes and recording.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    install_requires=[
        "lz4",
        "mcap",
        "numba",
        "numpy",
        "PyYAML",
        "rich",
        "scipy",
        "setproctitle",
        "zstandard",
    ],
    extras_require={"test": ["pytest"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flock_sim"]),
        (
            "share/flock_sim",
            ["package.xml", "machine.xml", "machine_3.xml", "network.xml", "network_3.xml"],
        ),
        (
            "share/flock_sim/launch",
            ["launch/flock.launch.py", "launch/composed.launch.py"],
        ),
    ],
    entry_points={
        "console_scripts": [
            "bird=flock_sim.nodes.executables:bird",
            "clock=flock_sim.nodes.executables:clock",
            "recorder=flock_sim.nodes.executables:recorder",
            "fly=flock_sim.commands.fly:main",
            "reference=flock_sim.commands.reference:main",
        ],
    },
)

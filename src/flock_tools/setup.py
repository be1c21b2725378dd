# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flock_tools",
    version="0.1.0",
    description="Offline tools: recorded flights, steady states, stability limits, figures.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={"flock_tools": ["page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flock_tools"]),
        ("share/flock_tools", ["package.xml", "view/view.rviz", "view/foxglove.json"]),
    ],
    entry_points={
        "console_scripts": [
            "metrics=flock_tools.metrics:main",
            "compare=flock_tools.compare:main",
            "picture=flock_tools.picture:main",
            "report=flock_tools.report:main",
            "play=flock_tools.play:main",
            "watch=flock_tools.watch:main",
            "view=flock_tools.view:main",
            "repair=flock_tools.repair:main",
            "figures=flock_tools.figures:main",
            "equilibrium=flock_tools.equilibrium:main",
            "limits=flock_tools.limits:main",
            "survey=flock_tools.survey:main",
            "study=flock_tools.study:main",
            "sweep=flock_tools.sweep:main",
        ],
    },
)

# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flock_tools",
    version="0.1.0",
    description="Tools of Flock: recorded and live flights, steady states, limits and figures.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    install_requires=[
        "distributed",
        "Jinja2",
        "matplotlib",
        "numpy",
        "PyYAML",
        "rich",
        "scipy",
        "websockets",
        "xarray",
    ],
    extras_require={"test": ["pytest"]},
    package_data={"flock_tools": ["report/assets/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flock_tools"]),
        ("share/flock_tools", ["package.xml", "view/view.rviz", "view/foxglove.json"]),
    ],
    entry_points={
        "console_scripts": [
            "metrics=flock_tools.commands.metrics:main",
            "compare=flock_tools.commands.compare:main",
            "picture=flock_tools.commands.picture:main",
            "report=flock_tools.commands.report:main",
            "play=flock_tools.commands.play:main",
            "watch=flock_tools.commands.watch:main",
            "view=flock_tools.commands.view:main",
            "repair=flock_tools.commands.repair:main",
            "figures=flock_tools.commands.figures:main",
            "equilibrium=flock_tools.commands.equilibrium:main",
            "response=flock_tools.commands.response:main",
            "limits=flock_tools.commands.limits:main",
            "arrange=flock_tools.commands.arrange:main",
            "survey=flock_tools.commands.survey:main",
            "study=flock_tools.commands.study:main",
            "sweep=flock_tools.commands.sweep:main",
        ],
    },
)

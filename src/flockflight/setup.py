# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flockflight",
    version="0.1.0",
    description="Flocks from Python, as xarray datasets.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flockflight"]),
        ("share/flockflight", ["package.xml"]),
    ],
)

# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name="flockflight",
    version="0.1.0",
    description="Formation flight from Python: steady states, stability, disturbances and runs.",
    maintainer="The Flock authors",
    maintainer_email="flock@example.org",
    license="Apache-2.0",
    packages=find_packages(),
    install_requires=["matplotlib", "numpy", "pandas", "xarray"],
    extras_require={"test": ["pytest"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/flockflight"]),
        ("share/flockflight", ["package.xml"]),
    ],
)

# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "tpgmm_core"

setup(
    name=package_name,
    version="0.1.0",
    description="Task-parameterized Gaussian mixture models: learning, retrieval, control; no ROS",
    maintainer="tpgmm maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-91c8a9ef.example",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.12",
    install_requires=["joblib", "numpy", "scipy", "numba"],
    extras_require={
        "predictive": ["daqp"],
        "robot": ["pin", "example-robot-data", "pyyaml"],
        "test": ["hypothesis", "pytest", "scikit-learn"],  # `colcon test` asks for pytest here
    },
    zip_safe=True,
)

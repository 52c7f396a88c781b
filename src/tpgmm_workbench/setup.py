# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

package_name = "tpgmm_workbench"

setup(
    name=package_name,
    version="0.1.0",
    description="A page on which a robot is taught a skill, and runs it: teach, train, preview, run",
    maintainer="tpgmm maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-91c8a9ef.example",
    license="Apache-2.0",
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={package_name: ["py.typed", "page/added/*.js", "page/added/*.css"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.12",
    install_requires=["tpgmm_ros", "tpgmm_demos", "matplotlib", "viser", "trimesh", "websockets", "pycollada"],
    extras_require={"test": ["pytest"]},  # `colcon test` asks for pytest here
    entry_points={
        "console_scripts": [
            "simulated_workbench = tpgmm_workbench.executables:simulated_workbench",
            "workbench = tpgmm_workbench.executables:workbench",
        ]
    },
    zip_safe=True,
)

# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

package_name = "tpgmm_ros"

setup(
    name=package_name,
    version="0.1.0",
    description="Nodes and programs for task-parameterized Gaussian mixture models",
    maintainer="tpgmm maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-91c8a9ef.example",
    license="Apache-2.0",
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        # Tasks and robots; config/ at the top of the repository is a link to them
        (f"share/{package_name}/config", [*glob("config/*.yaml"), *glob("config/tpgmm.*")]),
        (f"share/{package_name}/config/security", glob("config/security/*.xml")),
    ],
    python_requires=">=3.12",
    install_requires=["tpgmm_core[robot]", "backports.zstd", "joblib", "lz4", "rosbags", "tqdm"],
    extras_require={
        "lerobot": ["pyarrow>=21"],  # 21 is the first that loads no pickles from a schema, whatever it says
        "test": ["hypothesis", "pytest"],  # `colcon test` asks for pytest here
    },
    entry_points={
        "console_scripts": [
            "frame_tracker = tpgmm_ros.executables:frame_tracker",
            "reproduction = tpgmm_ros.executables:reproduction",
            "impedance_controller = tpgmm_ros.executables:impedance_controller",
            "joint_motion = tpgmm_ros.executables:joint_motion",
            "joint_reference = tpgmm_ros.executables:joint_reference",
            "baxter_simulator = tpgmm_ros.executables:baxter_simulator",
            "endpoint_poses = tpgmm_ros.executables:endpoint_poses",
            "recognition = tpgmm_ros.executables:recognition",
            "compose = tpgmm_ros.executables:compose",
            "check_robot = tpgmm_ros.executables:check_robot",
            "convert = tpgmm_ros.executables:convert",
            "inspect = tpgmm_ros.executables:inspect",
            "record = tpgmm_ros.executables:record",
            "teach = tpgmm_ros.executables:teach",
            "train = tpgmm_ros.executables:train",
            "evaluate = tpgmm_ros.executables:evaluate",
            "show = tpgmm_ros.executables:show",
            "recognize = tpgmm_ros.executables:recognize",
            "demo = tpgmm_ros.executables:demo",
            "figure5 = tpgmm_ros.executables:figure5",
            "workbench = tpgmm_ros.executables:workbench",
        ]
    },
    zip_safe=True,
)

# SPDX-License-Identifier: Apache-2.0
"""Files that come with the package."""

from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory


def config_file(name: str) -> Path:
    """A file of the project's ``config/``: that of the working directory if it has one, else the installed one."""
    local = Path("config") / name
    return local if local.exists() else installed_config_file(name)


def installed_config_file(name: str) -> Path:
    """The installed one."""
    try:
        return Path(get_package_share_directory("tpgmm_ros")) / "config" / name
    except PackageNotFoundError:
        return Path("config") / name

# SPDX-License-Identifier: Apache-2.0
"""Classes of messages and actions by the names of their types."""

from __future__ import annotations

import importlib
from typing import Any


def message_class(message_type: str) -> Any:
    """The class of a type of messages or of actions.

    Parameters
    ----------
    message_type
        full name, such as geometry_msgs/msg/PoseStamped or control_msgs/action/FollowJointTrajectory

    Returns
    -------
    type
        the class

    Raises
    ------
    ModuleNotFoundError
        its package is not installed.
    """
    package, kind, name = message_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except ModuleNotFoundError:
        raise ModuleNotFoundError(
            f"{message_type} is not installed: run 'make setup', or on a full installation 'apt install "
            f"ros-jazzy-{package.replace('_', '-')}'"
        ) from None


def type_name(kind: Any) -> str:
    """Full name of a class of messages, as `message_class` takes it."""
    package, group, *_ = kind.__module__.split(".")
    return f"{package}/{group}/{kind.__name__}"

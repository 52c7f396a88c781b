# SPDX-License-Identifier: Apache-2.0
"""Names that task files and model files of earlier versions hold, and what they are called now.

Every name of a retrieval method, of an encoding or of a kind of model that comes from a file or a parameter passes
through `current_name`, so that old files still work. New files hold the new names only.
"""

from __future__ import annotations

RENAMED = {
    "decay": "dmp",  # retrieval method, and the encoding of its models
    "dynamics": "dynamical_system",  # retrieval method
    "GoalTPGMM": "EndpointTPGMM",  # kind of model
}

RENAMED_PARAMETERS = {"risk": "risk_share", "leading_damping": "hand_guiding_damping"}
"""Of nodes. ROS drops what a node does not declare without a word, hence nodes refuse to start with the old names."""


def current_name(name: str) -> str:
    """Return the present name of what `name` called in an earlier version; `name` itself where it has not changed."""
    return RENAMED.get(name, name)

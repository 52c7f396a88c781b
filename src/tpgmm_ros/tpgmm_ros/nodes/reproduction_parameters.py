# SPDX-License-Identifier: Apache-2.0
"""The parameters of `reproduction`."""

from __future__ import annotations

from tpgmm_core.retrieval.knowledge import KnowledgeConfig
from tpgmm_core.retrieval.methods import ALL_METHODS
from tpgmm_core.retrieval.outcome import ExecutionConfig
from tpgmm_core.retrieval.phase import PHASES
from tpgmm_ros.nodes.joint_states import MAX_FUTURE, SPREAD
from tpgmm_ros.runtime.parameters import Declared, declared_of

PARAMETERS = [
    Declared("task_file", "", "Task file (YAML): frames and the movement's topic", fixed=True),
    Declared(
        "model_file",
        "",
        "Model file (.tpgmm) that is loaded when the node is configured; several, for movements at the same time: with "
        "' + ' between them",
        fixed=True,
    ),
    Declared(
        "joint_state_rate",
        1000.0,
        "Rate at which joint states are expected, Hz: lost ones are counted",
        1.0,
        10000.0,
        fixed=True,
    ),
    SPREAD,
    MAX_FUTURE,
    Declared("autostart", False, "Configure and activate at start, without a lifecycle manager", fixed=True),
    Declared(
        "lockstep_rate",
        0.0,
        "Lockstep: rate of poses and task parameters, Hz; each step waits for those of its own tick; 0: no lockstep",
        0.0,
        1000.0,
        fixed=True,
    ),
    Declared("broadcast_transforms", False, "Publish the reference on /tf too, as TASK/reference", fixed=True),
    Declared("rate", 0.0, "Rate of references on a timer, Hz; 0: one for each joint state", 0.0, 2000.0, fixed=True),
    Declared(
        "retrieval", "", f"Retrieval method: {', '.join(ALL_METHODS)}; empty: the one that the model was learned for"
    ),
    Declared("phase", "clock", f"What advances the model's time: {', '.join(PHASES)}"),
    Declared("speed", 1.0, "Speed of the movement; 1: as learned; 0: pause; below 0: backwards", -2.0, 2.0),
    Declared("horizon_steps", 1, "Number of future Gaussians in each reference", 0, 50),
    Declared("horizon_time_step", 0.005, "Time between future Gaussians, s", 0.001, 1.0),
    Declared(
        "blend_time",
        0.15,
        "Time constant with which the reference adapts to frames that moved, were lost or came back, s",
        0.001,
        5.0,
    ),
    Declared(
        "max_novelty",
        0.0,
        "Movements are refused in situations that are newer to the model than this; 1: as new as the demonstrations "
        "left out in training with --leave-one-out; 0: never",
        0.0,
        1.0e6,
    ),
    *declared_of(ExecutionConfig),
    *declared_of(KnowledgeConfig),
]

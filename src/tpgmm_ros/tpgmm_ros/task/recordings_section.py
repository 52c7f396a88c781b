# SPDX-License-Identifier: Apache-2.0
"""The part `recordings` of a task file: where recordings have the movement, if not where it is live.

{movement: {...}}                                                # another topic or message: see `source_entries`
{pose_array: demo/poses, period: 0.02, frames: frames.yaml}      # one PoseArray per bag
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, a_topic
from tpgmm_ros.messages.sources import JointStateSource, Source
from tpgmm_ros.task.source_entries import read_movement


@dataclass(frozen=True, slots=True)
class PoseArraySpec:
    """Recordings whose movement is one PoseArray per bag, and whose frames stand in a file.

    Attributes
    ----------
    pose_array
        relative topic of the PoseArray
    period
        time from one pose to the next, s: a PoseArray does not tell
    frames
        name of the file beside the bags that holds the constant pose of each observed frame in each bag
    """

    pose_array: str
    period: float
    frames: str


def read_recordings(section: Section, base_frame: str) -> tuple[PoseArraySpec | None, Source | JointStateSource | None]:
    """Where recordings have the movement, as the part `recordings` of a task file says.

    Parameters
    ----------
    section
        of the file; it may be empty
    base_frame
        frame_id in which poses are expressed

    Returns
    -------
    PoseArraySpec or None
        where each demonstration is one PoseArray
    Source or JointStateSource or None
        where the movement is observed in another way than live

    Raises
    ------
    YamlError
        the part does not describe recordings
    """
    section.refuse_others("pose_array", "period", "frames", "movement", "takes")
    if not section.values.keys() - {"takes"}:
        return None, None
    if "movement" in section.values:
        section.refuse_others("movement", "takes")
        return None, read_movement(section.section("movement"), base_frame)
    spec = PoseArraySpec(
        pose_array=section.required("pose_array", a_topic),
        period=section.required("period", _period),
        frames=section.required("frames", _file_name),
    )
    return spec, None


def _period(value: Any) -> float:
    try:
        return a_number(1e-6)(value)
    except ValueError:
        raise ValueError("the time from one pose to the next in s, such as 0.02") from None


def _file_name(value: Any) -> str:
    if not isinstance(value, str) or value != Path(value).name or not value:
        raise ValueError("the name of a file that lies beside the bags, such as frames.yaml")
    return value

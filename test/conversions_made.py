# SPDX-License-Identifier: Apache-2.0
"""Demonstrations as tables of other programs, and what `convert` makes of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synthetic_bags import reach
from tpgmm_core.common.types import Array
from tpgmm_ros.programs import convert
from tpgmm_ros.recordings.bags import find_bags, read_recording
from tpgmm_ros.task.task_file import Task

TIMES = np.linspace(0.0, 4.0, 41)


def shown(seed: int) -> tuple[Array, Array]:
    """The hand (41, 7), and where the object was (7,)."""
    topics = reach(seed, samples=41, duration=4.0)
    return topics["/endpoint/pose"].poses, topics["/object/pose"].poses[0]


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> dict[str, Any]:
    status = convert.main([*map(str, arguments), "--json"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert status == (0 if found["passed"] else 1)
    return found


def holds(bags: Path, number: int, hand: Array, place: Array | None) -> None:
    """The bag has these poses at these times, as a reader of the task sees them."""
    recording = read_recording(find_bags([bags])[number], Task.load(bags / "task.yaml"))
    np.testing.assert_allclose(recording.times, TIMES, atol=1e-9)
    np.testing.assert_allclose(recording.movement, hand, atol=1e-12)
    if place is not None:
        np.testing.assert_allclose(recording.frames["object"], np.tile(place, (41, 1)), atol=1e-12)


def csv_of(hand: Array, place: Array, times: Array = TIMES) -> str:
    names = "t,x,y,z,qx,qy,qz,qw,ox,oy,oz,oqx,oqy,oqz,oqw,width"
    rows = [[t, *pose, *place, 0.04 - 0.01 * (t > 2.0)] for t, pose in zip(times, hand, strict=True)]
    return "\n".join([names, *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n"


COLUMNS = ["--time", "t", "--movement", "x,y,z,qx,qy,qz,qw", "--frame", "object=ox,oy,oz,oqx,oqy,oqz,oqw"]

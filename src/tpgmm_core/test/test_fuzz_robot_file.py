# SPDX-License-Identifier: Apache-2.0
"""Untrusted robot files and URDFs: refused in words, or a robot; and they read no files but their own."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robots import ARM, ARM_URDF, write_arm
from tpgmm_core.common.safe_yaml import MAX_BYTES, MAX_DEPTH, YamlError, parse_yaml
from tpgmm_core.robot.description import MAX_URDF_BYTES, MAX_URDF_DEPTH, MAX_URDF_JOINTS, RobotFileError
from tpgmm_core.robot.model import RobotModel

EXAMPLES = int(os.environ.get("TPGMM_FUZZ_EXAMPLES", "100"))
FUZZ = settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.too_slow])
URDF = ARM_URDF.format(effort=10, turn="revolute")

_NUMBERS = st.sampled_from([0, -1, 1e300, -1e300, float("nan"), float("inf"), 10**400])
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates() | _NUMBERS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8) | st.integers(), inner, max_size=4),
    max_leaves=6,
)


def is_robot(path: Path) -> bool:
    """Whether the file describes a robot; if not, the error has to be the one that is promised."""
    try:
        robot = RobotModel.from_file(path)
    except RobotFileError as error:
        assert path.name in str(error) and len(str(error)) < 5000
        return False
    data = robot.create_data()
    data.update(robot.home)
    return bool(robot.nv > 0)


@FUZZ
@given(st.data())
def test_any_value_in_a_robot_file_is_refused_in_words_or_taken(data: st.DataObject) -> None:
    content: dict[str, Any] = dict(ARM)
    key = data.draw(st.sampled_from(sorted(content)))
    if isinstance(content[key], dict) and data.draw(st.booleans()):
        content[key] = {**content[key], data.draw(st.sampled_from(sorted(content[key]))): data.draw(_VALUES)}
    else:
        content[key] = data.draw(_VALUES)
    with tempfile.TemporaryDirectory() as folder:
        is_robot(write_arm(Path(folder), content))


@FUZZ
@given(st.data())
def test_a_robot_file_with_a_slip_is_refused_in_words_or_taken(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write_arm(Path(folder))
        content = bytearray(path.read_bytes())
        at = data.draw(st.integers(0, len(content)))
        content[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=4))
        path.write_bytes(content)
        is_robot(path)


@FUZZ
@given(st.data())
def test_a_urdf_with_a_slip_is_refused_in_words_or_taken(data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write_arm(Path(folder))
        text = URDF
        for _ in range(data.draw(st.integers(1, 3))):
            at = data.draw(st.integers(0, len(text)))
            slip = data.draw(st.sampled_from(["", "nan", "inf", "1e999", "-", '"', "<", "</link>", "0", "x"]))
            text = text[:at] + slip + text[at + data.draw(st.integers(0, 6)) :]
        (Path(folder) / "arm.urdf").write_text(text)
        is_robot(path)


@pytest.mark.parametrize(
    ("urdf", "complaint"),
    [
        ("<robot name='r'>" + "<joint/>" * (MAX_URDF_JOINTS + 1) + "</robot>", "joints"),
        ("<a>" * (MAX_URDF_DEPTH + 1) + "</a>" * (MAX_URDF_DEPTH + 1), "levels"),
        ("<a>" * 300_000, "levels"),
        ("<!DOCTYPE r [<!ENTITY a 'aaaaaaaa'><!ENTITY b '&a;&a;&a;&a;'>]><robot name='&b;'/>", "document type"),
        ("<!DOCTYPE r [<!ENTITY a SYSTEM 'file:///etc/hostname'>]><robot name='&a;'/>", "document type"),
        (URDF + " " * MAX_URDF_BYTES, "bytes"),
        (URDF[:-9], "no XML"),
        ("", "no XML"),
    ],
)
def test_a_urdf_that_its_parser_should_not_be_given_is_refused_before(
    urdf: str, complaint: str, tmp_path: Path
) -> None:
    path = write_arm(tmp_path)
    (tmp_path / "arm.urdf").write_text(urdf)
    with pytest.raises(RobotFileError, match=complaint):
        RobotModel.from_file(path)


def test_a_robot_file_reads_nothing_outside_its_folder(tmp_path: Path) -> None:
    (tmp_path / "outside.urdf").write_text(URDF)
    folder = tmp_path / "robot"
    folder.mkdir()
    (folder / "link.urdf").symlink_to(tmp_path / "outside.urdf")
    whole = str(tmp_path / "outside.urdf")
    for reference in ("../outside.urdf", whole, "~/outside.urdf", "package://../outside.urdf", "link.urdf"):
        with pytest.raises(RobotFileError, match="outside the robot file's folder"):
            RobotModel.from_file(write_arm(folder, {"urdf": reference}))
    (folder / "urdf").mkdir()
    (folder / "urdf" / "arm.urdf").write_text(URDF)
    (folder / "inside.urdf").symlink_to(folder / "urdf" / "arm.urdf")
    for reference in ("urdf/arm.urdf", "inside.urdf"):
        assert RobotModel.from_file(write_arm(folder, {"urdf": reference})).nv == 2


BOMB = "a: &a [x, x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}]\n" for a, b in zip("abc", "bcd", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1),
        "[" * (MAX_BYTES // 2),
        "{a: " * (MAX_BYTES // 4),
        "- " * (MAX_BYTES // 2),
        "? " * (MAX_BYTES // 2),
        "!!python/object/apply:os.system ['exit 1']",
        "!!python/name:os.system",
        "a: 1\na: 2",
        "9" * 5000,
        "a: 2026-99-99",
    ],
)
def test_yaml_that_asks_for_more_than_a_file_says_is_refused(text: str) -> None:
    with pytest.raises(YamlError, match=r"here\.yaml"):
        parse_yaml(text, "here.yaml")


def test_yaml_may_be_as_deep_as_files_of_the_project_need() -> None:
    assert parse_yaml("[" * (MAX_DEPTH - 1) + "1" + "]" * (MAX_DEPTH - 1), "here.yaml")
    assert parse_yaml(yaml.safe_dump(ARM), "here.yaml") == ARM


def test_a_pipe_or_a_folder_is_no_robot_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    for path in (tmp_path / "pipe.yaml", tmp_path, tmp_path / "none.yaml"):
        with pytest.raises(RobotFileError, match="cannot be read"):
            RobotModel.from_file(path)

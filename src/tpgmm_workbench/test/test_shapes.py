# SPDX-License-Identifier: Apache-2.0
"""What a robot looks like: meshes where they are, simple shapes where they are not, and coarse enough for a browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tpgmm_core.geometry.quaternion import rotation_matrix
from tpgmm_core.robot.description import RobotDescription
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.scene.robot_display import joined
from tpgmm_workbench.scene.shapes import MAX_TRIANGLES, Shape, coarse, read_shapes

ROOT = Path(__file__).resolve().parents[3]
URDF = """<robot name="two"><link name="a"/><link name="b">{visual}</link><link name="c"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="k" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0.2 0 0"/></joint></robot>"""


def urdf(tmp_path: Path, visual: str = "") -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF.format(visual=visual))
    return path


def test_a_chain_without_any_shape_is_seen_as_capsules_from_joint_to_joint(tmp_path: Path) -> None:
    shapes = read_shapes(urdf(tmp_path))
    assert [part.link for part in shapes.parts] == ["a", "b"]
    first, second = shapes.parts
    assert first.vertices[:, 2].max() == pytest.approx(0.3, abs=0.04)
    assert second.vertices[:, 0].max() == pytest.approx(0.2, abs=0.06)


def test_a_mesh_of_the_robots_folder_is_scaled_and_placed(tmp_path: Path) -> None:
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.stl")
    visual = (
        '<visual><origin xyz="1 0 0" rpy="0 0 1.5707963"/><geometry><mesh filename="box.stl" scale="2 1 1"/></geometry>'
        "</visual>"
    )
    (part,) = [part for part in read_shapes(urdf(tmp_path, visual)).parts if part.link == "b"]
    np.testing.assert_allclose(part.vertices.min(axis=0), [0.95, -0.1, -0.05], atol=1e-6)
    np.testing.assert_allclose(part.vertices.max(axis=0), [1.05, 0.1, 0.05], atol=1e-6)


@pytest.mark.parametrize("name", ["missing.stl", "../outside.stl", "broken.stl"])
def test_a_mesh_that_cannot_be_read_is_told_of_and_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / "broken.stl").write_text("solid but not")
    visual = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    shapes = read_shapes(urdf(tmp_path, visual))
    assert any(part.link == "b" for part in shapes.parts)
    assert "b: no mesh" in shapes.notes[0]


def test_a_fine_mesh_becomes_coarse_and_keeps_its_size() -> None:
    fine = trimesh.creation.icosphere(5, 0.2)
    few = coarse(fine)
    assert 50 < len(few.faces) <= MAX_TRIANGLES < len(fine.faces)
    np.testing.assert_allclose(few.extents, fine.extents, atol=0.04)


def test_baxter_without_meshes_has_a_shape_for_each_link_of_its_arms() -> None:
    shapes = read_shapes(RobotDescription.from_file(ROOT / "config" / "baxter.yaml").urdf, meshes=False)
    links = {part.link for part in shapes.parts}
    assert {f"left_{name}" for name in ("upper_shoulder", "lower_elbow", "wrist")} <= links
    assert not shapes.notes


def test_what_moves_together_is_drawn_as_one_and_stays_where_it_is() -> None:
    robot = RobotModel.from_file(ROOT / "config" / "baxter.yaml")
    shapes = read_shapes(RobotDescription.from_file(ROOT / "config" / "baxter.yaml").urdf, meshes=False)
    bodies = joined(shapes, robot, (1, 2, 3))
    assert len(bodies) <= 1 + len(robot.joint_names)
    data = robot.create_data()
    data.update(robot.home + 0.1)

    def points(parts: tuple[Shape, ...]) -> np.ndarray:
        poses = [data.frame_pose(robot.frame_id(part.link)) for part in parts]
        placed = [part.vertices @ rotation_matrix(x[3:]).T + x[:3] for part, x in zip(parts, poses, strict=True)]
        return np.sort(np.concatenate(placed), axis=0)

    known = tuple(part for part in shapes.parts if robot.pinocchio.existFrame(part.link))
    np.testing.assert_allclose(points(bodies), points(known), atol=1e-9)
    assert sum(len(part.faces) for part in bodies) == sum(len(part.faces) for part in known)

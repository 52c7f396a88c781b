# SPDX-License-Identifier: Apache-2.0
"""What a robot looks like, of any URDF: triangles in the axes of its links.

Meshes of a URDF are read where they can be; a link without one gets its collision shapes, and where it has none either,
capsules from its own origin to the joints that it carries, so that a kinematic chain is always seen. Fine meshes are
made coarse: a page in a browser draws all of it many times per second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from numpy.typing import NDArray

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.description import RobotFileError, resolve_urdf
from tpgmm_core.robot.urdf_tree import UrdfTree, read_tree

#: A part of a link with more triangles is made coarse, with cells of this size at least, m.
MAX_TRIANGLES, CELL = 900, 0.006
#: Larger files are not read; no robot's link needs them.
MAX_MESH_BYTES = 40_000_000
CAPSULE_RADIUS = 0.035
GREY = (150, 150, 155)


@dataclass(frozen=True, slots=True)
class Shape:
    """A part of a link: triangles of one colour.

    Parameters
    ----------
    link
        name of the link in the URDF
    vertices
        (V, 3), m, in the axes of the link
    faces
        (F, 3), indices of vertices
    color
        red, green, blue, 0 to 255
    """

    link: str
    vertices: Array
    faces: NDArray[np.int64]
    color: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Shapes:
    """All parts of a robot, and what could not be read of them, in words."""

    parts: tuple[Shape, ...]
    notes: tuple[str, ...]


def read_shapes(urdf: Path, meshes: bool = True) -> Shapes:
    """What a robot looks like.

    Parameters
    ----------
    urdf
        its file
    meshes
        False: simple shapes only, which are drawn faster

    Returns
    -------
    Shapes
        of all links that can be seen

    Raises
    ------
    RobotFileError
        where the URDF cannot be read
    """
    tree = read_tree(urdf)
    known: dict[Path, list[tuple[trimesh.Trimesh, tuple[int, int, int]]]] = {}
    parts: list[Shape] = []
    notes: list[str] = []
    for link in tree.root.iter("link"):
        found = [*_of_link(link, "visual", urdf.parent, known, notes)] if meshes else []
        parts += found or [*_of_link(link, "collision", urdf.parent, None, notes)] or [*_capsules(link, tree)]
    return Shapes(tuple(parts), tuple(dict.fromkeys(notes)))


def _of_link(
    link: Element,
    kind: str,
    folder: Path,
    known: dict[Path, list[tuple[trimesh.Trimesh, tuple[int, int, int]]]] | None,
    notes: list[str],
) -> Iterator[Shape]:
    """The shapes of a link; meshes only where there is a place to keep what was read of them."""
    for entry in link.findall(kind):
        geometry = entry.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            continue
        placed = _placement(entry)
        if shape.tag == "mesh":
            if known is None:
                continue
            try:
                path = resolve_urdf(shape.get("filename", ""), folder)
                if path not in known:
                    known[path] = _read_mesh(path)
            except Exception as error:  # readers of meshes raise whatever comes to their mind
                notes.append(f"{link.get('name')}: no mesh: {one_line(error, 200)}")
                continue
            placed = placed @ np.diag([*_numbers(shape.get("scale"), 3, 1.0), 1.0])
            solids = known[path]
        else:
            solid = _solid(shape)
            solids = [] if solid is None else [(solid, GREY)]
        for solid, color in solids:
            vertices = np.asarray(solid.vertices) @ placed[:3, :3].T + placed[:3, 3]
            yield Shape(link.get("name", ""), vertices, np.asarray(solid.faces), color)


def _read_mesh(path: Path) -> list[tuple[trimesh.Trimesh, tuple[int, int, int]]]:
    """The parts of a mesh file by their colours, coarse enough to be drawn."""
    if path.stat().st_size > MAX_MESH_BYTES:
        raise RobotFileError(f"{path.name} has more than {MAX_MESH_BYTES} bytes")
    loaded = trimesh.load(path, process=False)
    solids = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    scale = trimesh.units.unit_conversion(loaded.units, "meters") if loaded.units else 1.0
    by_color: dict[tuple[int, int, int], list[trimesh.Trimesh]] = {}
    for solid in solids:
        if isinstance(solid, trimesh.Trimesh) and len(solid.faces):
            solid.apply_scale(scale)
            by_color.setdefault(_color(solid), []).append(solid)
    if not by_color:
        raise RobotFileError(f"{path.name} holds no triangles")
    joined: dict[tuple[int, int, int], Any] = {
        color: trimesh.util.concatenate(same) for color, same in by_color.items()
    }
    return [(coarse(solid), color) for color, solid in joined.items()]


def coarse(solid: trimesh.Trimesh, most: int = MAX_TRIANGLES, cell: float = CELL) -> trimesh.Trimesh:
    """A mesh with fewer triangles: all vertices of a cell become one, and triangles without an area are gone.

    Parameters
    ----------
    solid
        the mesh
    most
        triangles that it may have
    cell
        size of a cell, m; cells grow until there are few enough triangles

    Returns
    -------
    trimesh.Trimesh
        the same surface, to about the size of a cell
    """
    vertices, faces = np.asarray(solid.vertices), np.asarray(solid.faces)
    while len(faces) > most:
        vertices, faces = _clustered(np.asarray(solid.vertices), np.asarray(solid.faces), cell)
        cell *= 1.4
    return trimesh.Trimesh(vertices, faces, process=False)


def _clustered(vertices: Array, faces: NDArray[np.int64], cell: float) -> tuple[Array, NDArray[np.int64]]:
    cells = np.round(vertices / cell).astype(np.int64)
    _, inverse, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    middles = np.stack([np.bincount(inverse, vertices[:, i]) for i in range(3)], axis=1) / counts[:, None]
    joined = inverse[faces]
    kept = (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 0] != joined[:, 2])
    _, first = np.unique(np.sort(joined[kept], axis=1), axis=0, return_index=True)
    return middles, joined[kept][np.sort(first)]


def _color(solid: trimesh.Trimesh) -> tuple[int, int, int]:
    material = getattr(solid.visual, "material", None)
    found: Any = getattr(material, "main_color", None)
    if found is None:
        found = getattr(solid.visual, "main_color", (*GREY, 255))
    red, green, blue = (int(value) for value in list(found)[:3])
    return red, green, blue


def _solid(shape: Element) -> trimesh.Trimesh | None:
    """A simple shape of a URDF, around its middle; None for one that is too small to be seen, or that is none."""
    if shape.tag == "box":
        size = _numbers(shape.get("size"), 3, 0.0)
        solid = trimesh.creation.box(size) if min(size) > 0.0 else None
    elif shape.tag == "cylinder":
        radius, length = float(shape.get("radius", 0.0)), float(shape.get("length", 0.0))
        solid = trimesh.creation.cylinder(radius, length, sections=24) if radius > 0.0 < length else None
    elif shape.tag == "sphere":
        radius = float(shape.get("radius", 0.0))
        solid = trimesh.creation.icosphere(2, radius) if radius > 0.0 else None
    else:
        solid = None
    return solid if solid is not None and solid.extents.max() > 0.005 else None


def _capsules(link: Element, tree: UrdfTree) -> Iterator[Shape]:
    """From the origin of a link to those of the joints that it carries."""
    name = link.get("name", "")
    for joint in tree.joints.values():
        parent = joint.find("parent")
        if parent is None or parent.get("link") != name:
            continue
        end = _placement(joint)[:3, 3]
        length = float(np.linalg.norm(end))
        if length > 0.01:
            radius = min(CAPSULE_RADIUS, 0.3 * length)
            solid = trimesh.creation.capsule(length, radius, count=[10, 10])
            solid.apply_translation([0.0, 0.0, 0.5 * length - solid.bounds[:, 2].mean()])
            turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], end / length)
            yield Shape(name, np.asarray(solid.vertices) @ turn[:3, :3].T, np.asarray(solid.faces), GREY)


def _placement(element: Element) -> Array:
    """The (4, 4) transform of an element's origin."""
    origin = element.find("origin")
    placed = np.eye(4)
    if origin is not None:
        roll, pitch, yaw = _numbers(origin.get("rpy"), 3, 0.0)
        turn = quaternion.multiply(
            quaternion.exp([0.0, 0.0, yaw]),
            quaternion.multiply(quaternion.exp([0.0, pitch, 0.0]), quaternion.exp([roll, 0.0, 0.0])),
        )
        placed[:3, :3] = quaternion.rotation_matrix(turn)
        placed[:3, 3] = _numbers(origin.get("xyz"), 3, 0.0)
    return placed


def _numbers(text: str | None, count: int, otherwise: float) -> list[float]:
    return [float(word) for word in text.split()] if text and text.strip() else [otherwise] * count

# SPDX-License-Identifier: Apache-2.0
"""Where to demonstrate next: the placing of the frames that is newest to what is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.situations import Newness, how_new

PLACINGS = 200
NARROW_M, NARROW_RAD = 0.05, 0.2
"""Frames that were seen within less are put as far around, since their influence cannot be known otherwise."""
WIDER_M, WIDER_RAD = 0.1, 0.5
APART_M = 0.05
"""Frames are put no nearer to each other, unless they were shown nearer."""


@dataclass(frozen=True, slots=True)
class FrameRegion:
    """Where a frame may be put: corners of a box in the base frame, m, and how it may be turned about z, rad."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    yaw: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A placing of the observed frames.

    Parameters
    ----------
    frames
        name -> pose (7,) in the base frame
    novelty
        1 is as new as the newest so far
    words
        why there
    """

    frames: Mapping[str, Array]
    novelty: float
    words: str


def suggest(project: Project, regions: Mapping[str, FrameRegion] | None = None, random_state: int = 0) -> Suggestion:
    """Suggest where the frames should be for the next demonstration.

    Parameters
    ----------
    project
        with one demonstration at least, or with regions for all observed frames
    regions
        where frames may be; those that are not named: where they were seen, a little widened where that is one place
    random_state
        seed of the placings that are compared

    Returns
    -------
    Suggestion
        the newest of them

    Raises
    ------
    ProjectError
        where nothing says where the frames may be
    """
    shown = project.shown()
    given = dict(regions or {})
    unknown = [name for name in project.task.sources if name not in given]
    if unknown and not shown:
        raise ProjectError(
            f"nothing says where {', '.join(unknown)} may be: show one demonstration, or give a region for each"
        )
    situations = [one.situation for one in shown]
    places = {
        name: _Places.of([s[name] for s in situations if name in s], given.get(name)) for name in project.task.sources
    }
    rng, fixed = np.random.default_rng(random_state), project.fixed_frames()
    newness = Newness.of(project, shown)
    hand = None if not shown else np.asarray(np.mean([one.recording.movement[0] for one in shown], axis=0))
    if hand is not None:
        hand[3:] = quaternion.normalize(hand[3:])
    least = _least_distance(situations, tuple(places))
    best: tuple[float, dict[str, Array]] | None = None
    for _ in range(PLACINGS):
        placing = {name: place.sample(rng) for name, place in places.items()}
        if not _are_apart(placing, least):
            continue
        score = newness.of_situation({**fixed, **placing}, hand)
        if score is None:
            score = _distance(placing, situations)
        if np.isfinite(score) and (best is None or score > best[0]):
            best = float(score), placing
    if best is None:
        raise ProjectError(
            "in the given regions the frames are always nearer to each other than they were shown: give larger regions"
        )
    return Suggestion(best[1], best[0], _words(best[0], newness, places))


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where one frame may be: a box, and turns about z of one of the orientations that were seen."""

    low: Array
    high: Array
    yaw: tuple[float, float]
    upright: Array
    is_widened: bool

    @classmethod
    def of(cls, seen: Sequence[Array], region: FrameRegion | None) -> _Places:
        upright = quaternion.IDENTITY if not seen else np.asarray(seen[0][3:])
        if region is not None:
            return cls(np.array(region.low), np.array(region.high), region.yaw, upright, False)
        poses = np.array(seen)
        low, high = poses[:, :3].min(axis=0), poses[:, :3].max(axis=0)
        turns = quaternion.log(quaternion.multiply(poses[:, 3:], quaternion.conjugate(upright)))[:, 2]
        yaw = float(turns.min()), float(turns.max())
        is_widened = bool(np.ptp(poses[:, :2], axis=0).max() < NARROW_M)
        if is_widened:
            low, high = low - [WIDER_M, WIDER_M, 0.0], high + [WIDER_M, WIDER_M, 0.0]
        if yaw[1] - yaw[0] < NARROW_RAD and is_widened:
            yaw = yaw[0] - WIDER_RAD, yaw[1] + WIDER_RAD
        return cls(low, high, yaw, upright, is_widened)

    def sample(self, rng: np.random.Generator) -> Array:
        turn = quaternion.multiply(quaternion.exp([0.0, 0.0, rng.uniform(*self.yaw)]), self.upright)
        return np.concatenate([rng.uniform(self.low, self.high), turn])


def _least_distance(situations: Sequence[Mapping[str, Array]], names: Sequence[str]) -> float:
    """What observed frames were apart at least, m; at most APART_M."""
    apart = [
        float(np.linalg.norm(s[a][:3] - s[b][:3]))
        for s in situations
        for a, b in combinations(names, 2)
        if a in s and b in s
    ]
    return min([APART_M, *apart])


def _are_apart(placing: Mapping[str, Array], least: float) -> bool:
    return all(np.linalg.norm(a[:3] - b[:3]) >= least for a, b in combinations(placing.values(), 2))


def _distance(placing: Mapping[str, Array], situations: Sequence[Mapping[str, Array]]) -> float:
    """How far a placing is from the nearest one that was shown, m; a turn by 0.1 rad counts as a centimetre."""
    return min(
        (
            sum(
                float(np.linalg.norm(pose[:3] - s[name][:3]) + 0.1 * quaternion.angle_between(pose[3:], s[name][3:]))
                for name, pose in placing.items()
                if name in s
            )
            for s in situations
        ),
        default=0.0,
    )


def _words(score: float, newness: Newness, places: Mapping[str, _Places]) -> str:
    widened = [name for name, place in places.items() if place.is_widened]
    text = (
        "the farthest from what was shown"
        if newness.scale is None
        else f"where the model is least sure: {how_new(score, len(newness.scale.distances))}"
    )
    if widened:
        text += f"; {', '.join(widened)} was always at one place, so that its influence is not known: it is moved"
    return text

# SPDX-License-Identifier: Apache-2.0
"""How new a situation is while a skill runs, and a tube that is drawn only where it has changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest

from tpgmm_core.common.types import Array
from tpgmm_workbench.desk import novelty
from tpgmm_workbench.desk.novelty import MOVED_M, PERIOD, NoveltyView, RunNovelty
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page import words
from tpgmm_workbench.project.preview import NEW
from tpgmm_workbench.scene.colors import REFERENCE
from tpgmm_workbench.scene.tube_display import SEEN, TubeDisplay
from tpgmm_workbench.session.view import FrameView, GraphView

HAND = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])


class Clock:
    now = 100.0

    def monotonic(self) -> float:
        return self.now


class Background:
    """Does what it is given when it is told to."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Callable[[], Any], Callable[[Future[Any]], None]]] = []

    def run(self, work: Callable[[], Any], then: Callable[[Future[Any]], None]) -> None:
        self.jobs.append((work, then))

    def finish(self) -> int:
        count = len(self.jobs)
        for work, then in self.jobs:
            job: Future[Any] = Future()
            try:
                job.set_result(work())
            except ValueError as error:
                job.set_exception(error)
            then(job)
        self.jobs.clear()
        return count


class Known:
    """A model to which a situation is as new as its object is far away."""

    class scale:  # noqa: N801  as the attribute is called
        distances = (1.0,) * 8

    def of_situation(self, frames: Mapping[str, Array], hand: Array) -> float:
        np.testing.assert_array_equal(hand, HAND)
        if frames["object"][0] > 90.0:
            raise ValueError("too far to think of")
        return float(frames["object"][0])


def seen(x: float, hand: Array = HAND) -> GraphView:
    return GraphView(hand=hand, frames=(FrameView("object", "seen", 0.0, np.array([x, *HAND[1:]])),))


def test_a_situation_is_judged_anew_where_a_frame_has_moved_and_not_more_often(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, background = Clock(), Background()
    monkeypatch.setattr(novelty, "time", clock)
    monkeypatch.setattr(novelty.Newness, "of", classmethod(lambda cls, project, shown: Known()))
    judge = RunNovelty(None, background)  # type: ignore[arg-type]
    judge.watch(None, seen(0.3))
    judge.watch(3, seen(0.3))
    judge.watch(3, seen(0.9))
    assert judge.view is None and background.finish() == 1  # one at a time
    assert judge.view == NoveltyView(0.3, "like the demonstrations")
    judge.watch(3, seen(0.9))
    assert background.finish() == 0  # too early
    clock.now += 2.0 * PERIOD
    judge.watch(3, seen(0.3 + 0.5 * MOVED_M))
    assert background.finish() == 0  # nothing has moved
    judge.watch(3, seen(7.0, HAND + 0.1))  # the hand has; where it was as the movement began counts
    assert background.finish() == 1 and judge.view is not None and judge.view.score == 7.0
    assert "Novelty</b> now: 7.0, at most 2" in words.novelty(DeskView(novelty=judge.view))
    assert "too new" in words.novelty(DeskView(novelty=judge.view)) and judge.view.limit == NEW
    clock.now += 2.0 * PERIOD
    judge.watch(3, seen(99.0))
    background.finish()
    assert "not known: too far to think of" in words.novelty(DeskView(novelty=judge.view))
    clock.now += 2.0 * PERIOD
    judge.watch(3, seen(1.0))
    judge.watch(None, seen(1.0))
    assert background.finish() == 1 and judge.view is None and not words.novelty(DeskView())  # it came too late


class Mesh:
    def __init__(self, vertices: Array) -> None:
        self.vertices, self.visible, self.is_removed = vertices, True, False

    def remove(self) -> None:
        self.is_removed = True


class Scene:
    def __init__(self) -> None:
        self.meshes: list[Mesh] = []

    def add_mesh_simple(self, name: str, vertices: Array, faces: Array, **_: Any) -> Mesh:
        assert name == "/ahead" and faces.max() == len(vertices) - 1
        self.meshes.append(Mesh(vertices))
        return self.meshes[-1]


def test_a_tube_is_sent_only_where_it_has_changed() -> None:
    scene = Scene()
    display = TubeDisplay(scene, "/ahead", REFERENCE)  # type: ignore[arg-type]
    path = np.column_stack([np.linspace(0.0, 0.3, 13), np.zeros(13), np.zeros(13)])
    covariances = np.tile(1e-4 * np.eye(3), (13, 1, 1))
    assert not display.show(None, None) and not scene.meshes
    assert display.show(path, covariances) and not display.show(path + 0.3 * SEEN, covariances)
    assert display.show(path + 0.02, covariances) and len(scene.meshes) == 1
    corners = scene.meshes[0].vertices
    assert float(corners[:, 0].min()) == pytest.approx(0.02, abs=1e-6)
    assert float(np.ptp(corners[:, 1])) == pytest.approx(0.04, rel=1e-3)  # two standard deviations to each side
    assert display.show(None, None) and not display.show(None, None) and not scene.meshes[0].visible
    assert display.show(path + 0.02, covariances) and scene.meshes[0].visible and len(scene.meshes) == 1
    display.visible = False
    assert not display.visible and not scene.meshes[0].visible
    display.visible = True
    assert display.show(path[:5], covariances[:5]) and scene.meshes[0].is_removed and len(scene.meshes) == 2

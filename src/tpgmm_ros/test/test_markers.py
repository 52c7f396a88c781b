# SPDX-License-Identifier: Apache-2.0
"""What RViz is shown stands where it is."""

from __future__ import annotations

import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from tpgmm_core import Frame, GaussianMixture
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_ros.messages.markers import LIFETIME, Scene

TURN = quaternion.exp(np.array([0.0, 0.0, np.pi / 2]))


def points(marker: Marker) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def test_frames_stand_at_their_origins_with_their_axes_and_gaussians_at_their_means() -> None:
    covariance = np.diag([0.1, 0.01**2, 0.02**2, 0.03**2, 0.1, 0.1, 0.1])
    mean = np.array([0.5, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    mixture = GaussianMixture([1.0], mean[None], covariance[None], Manifold.parse("R1 x R3 x S3"))
    frame = Frame.from_pose([0.4, 0.5, 0.6], TURN).with_time()
    shown = Scene().show(mixture, np.array([1.0]), {"object": frame}, 7, "base").markers
    ellipsoid, path, axes = (
        next(marker for marker in shown if marker.ns == name) for name in ("components", "path", "frames/object")
    )
    position = ellipsoid.pose.position
    assert (position.x, position.y, position.z) == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(sorted([ellipsoid.scale.x, ellipsoid.scale.y, ellipsoid.scale.z]), [0.04, 0.08, 0.12])
    np.testing.assert_allclose(points(path), [[1.0, 2.0, 3.0]])
    drawn = points(axes)
    np.testing.assert_allclose(drawn[::2], [[0.4, 0.5, 0.6]] * 3)
    np.testing.assert_allclose(drawn[1::2] - drawn[::2], 0.1 * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-12)
    assert axes.text == "object" and all(marker.header.frame_id == "base" for marker in shown)


class Viewer:
    """What a viewer shows of a topic, by the rules of visualization_msgs/Marker."""

    def __init__(self) -> None:
        self.shown: dict[tuple[str, int], Marker] = {}

    def take(self, message: MarkerArray) -> None:
        for marker in message.markers:
            if marker.action == Marker.ADD:
                self.shown[marker.ns, marker.id] = marker
            elif marker.action == Marker.DELETE:
                self.shown.pop((marker.ns, marker.id), None)
            elif marker.action == Marker.DELETEALL:
                self.shown.clear()

    @property
    def names(self) -> set[str]:
        return {f"{ns} {number}" for ns, number in self.shown}


def mixture_of(K: int) -> GaussianMixture:
    means = np.tile([0.5, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], (K, 1))
    return GaussianMixture(
        np.full(K, 1 / K), means, np.tile(0.01 * np.eye(7), (K, 1, 1)), Manifold.parse("R1 x R3 x S3")
    )


def frames_of(*names: str) -> dict[str, Frame]:
    return {name: Frame.from_pose([len(name), 0.0, 0.0], TURN).with_time() for name in names}


@pytest.mark.parametrize("lost", [False, True], ids=["every message came", "one message was lost"])
def test_a_viewer_shows_what_is_there_now_and_each_frame_under_its_own_name(lost: bool) -> None:
    scene, viewer = Scene(), Viewer()
    assert scene.is_empty
    for K, names in ((5, ("object", "target", "robot")), (3, ("target", "robot")), (4, ("robot", "object"))):
        message = scene.show(mixture_of(K), np.full(K, 1 / K), frames_of(*names), 7, "base")
        if not (lost and K == 3):
            viewer.take(message)
            expected = {f"components {k}" for k in range(K)} | {f"frames/{name} 0" for name in names} | {"path 0"}
            # what a lost message would have deleted goes by itself
            stale = viewer.names - expected
            assert expected <= viewer.names and (lost or not stale)
        for (ns, _), marker in viewer.shown.items():
            assert marker.lifetime == LIFETIME and 0 < LIFETIME.sec < 10
            if ns.startswith("frames/"):
                assert marker.text == ns.removeprefix("frames/") and marker.points[0].x == len(marker.text)
    viewer.take(scene.clear(9, "base"))
    assert scene.is_empty and (lost or not viewer.shown)
    assert not scene.clear(10, "base").markers

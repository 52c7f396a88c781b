# SPDX-License-Identifier: Apache-2.0
"""What RViz is shown stands where it is."""

from __future__ import annotations

import numpy as np
from visualization_msgs.msg import Marker

from tpgmm_core import Frame, GaussianMixture, quaternion
from tpgmm_core.manifold import Manifold
from tpgmm_ros.markers import markers

TURN = quaternion.exp(np.array([0.0, 0.0, np.pi / 2]))


def points(marker: Marker) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def test_frames_stand_at_their_origins_with_their_axes_and_gaussians_at_their_means() -> None:
    covariance = np.diag([0.1, 0.01**2, 0.02**2, 0.03**2, 0.1, 0.1, 0.1])
    mean = np.array([0.5, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    mixture = GaussianMixture([1.0], mean[None], covariance[None], Manifold.parse("R1 x R3 x S3"))
    frame = Frame.from_pose([0.4, 0.5, 0.6], TURN).with_time()
    shown = markers(mixture, np.array([1.0]), {"object": frame}, 7, "base").markers
    ellipsoid, path, axes = (
        next(marker for marker in shown if marker.ns == name) for name in ("components", "path", "frames")
    )
    position = ellipsoid.pose.position
    assert (position.x, position.y, position.z) == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(sorted([ellipsoid.scale.x, ellipsoid.scale.y, ellipsoid.scale.z]), [0.04, 0.08, 0.12])
    np.testing.assert_allclose(points(path), [[1.0, 2.0, 3.0]])
    drawn = points(axes)
    np.testing.assert_allclose(drawn[::2], [[0.4, 0.5, 0.6]] * 3)
    np.testing.assert_allclose(drawn[1::2] - drawn[::2], 0.1 * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-12)
    assert axes.text == "object" and all(marker.header.frame_id == "base" for marker in shown)

# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove show of a reproduction: the adapted Gaussians, the path ahead and the frames."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tpgmm_core import Frame, GaussianMixture, quaternion
from tpgmm_core.quaternion import Array
from tpgmm_ros import conversions

_AXIS_LENGTH = 0.1
_AXES = [ColorRGBA(r=1.0, a=1.0), ColorRGBA(g=0.7, a=1.0), ColorRGBA(b=1.0, a=1.0)]


def markers(
    mixture: GaussianMixture, activations: Array, frames: Mapping[str, Frame], nanoseconds: int, frame_id: str
) -> MarkerArray:
    """Markers of one moment, replacing those of the last one.

    Args:
        mixture: the adapted components over poses and whatever else the model encodes.
        activations: (K,), how much each component takes part now; shown by its opacity.
        frames: the frames that took part, over [time, pose].
    """
    sphere = mixture.manifold.spheres[0]  # the position stands before the orientation
    place = slice(sphere.ambient.start - 3, sphere.ambient.start)
    spread = slice(sphere.tangent.start - 3, sphere.tangent.start)
    header = conversions.header_at(nanoseconds, frame_id)
    array = MarkerArray()
    for k, (mean, covariance) in enumerate(zip(mixture.means, mixture.covariances, strict=True)):
        values, vectors = np.linalg.eigh(covariance[spread, spread])
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        pose = np.concatenate([mean[place], quaternion.from_matrix(vectors)])
        marker = Marker(header=header, ns="components", id=k, type=Marker.SPHERE, action=Marker.ADD)
        marker.pose = conversions.pose_from_array(pose)
        # Two standard deviations to each side.
        marker.scale.x, marker.scale.y, marker.scale.z = (4.0 * np.sqrt(np.maximum(values, 1e-8))).tolist()
        marker.color = ColorRGBA(r=0.9, g=0.5, b=0.1, a=float(0.15 + 0.6 * activations[k]))
        array.markers.append(marker)
    path = Marker(header=header, ns="path", id=0, type=Marker.LINE_STRIP, action=Marker.ADD)
    path.scale.x = 0.004
    path.color = ColorRGBA(r=0.2, g=0.2, b=0.2, a=0.9)
    path.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in mixture.means[:, place]]
    array.markers.append(path)
    for index, (name, frame) in enumerate(frames.items()):
        array.markers.append(_axes(name, index, frame, header))
    return array


def _axes(name: str, index: int, frame: Frame, header: conversions.Header) -> Marker:
    marker = Marker(header=header, ns="frames", id=index, type=Marker.LINE_LIST, action=Marker.ADD, text=name)
    marker.scale.x = 0.006
    origin = frame.b[1:4]
    for axis, color in zip(frame.A[1:4, 1:4].T, _AXES, strict=True):
        for point in (origin, origin + _AXIS_LENGTH * axis):
            marker.points.append(Point(x=float(point[0]), y=float(point[1]), z=float(point[2])))
            marker.colors.append(color)
    return marker

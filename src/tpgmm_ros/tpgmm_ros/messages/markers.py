# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove show of a reproduction: the adapted Gaussians, the path ahead and the frames.

A viewer keeps what it was shown until it hears otherwise. So each marker has a name that stays the same (of its
component, of its frame), what is gone is deleted, and all of it is forgotten after `LIFETIME`: a message may get lost,
and a process that is killed deletes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from tpgmm_core import Frame, GaussianMixture
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_ros.messages import conversions

#: Markers that are not shown again for this long vanish; they come ten times per second. s
LIFETIME = Duration(sec=2)
_AXIS_LENGTH = 0.1
_AXES = [ColorRGBA(r=1.0, a=1.0), ColorRGBA(g=0.7, a=1.0), ColorRGBA(b=1.0, a=1.0)]


class Scene:
    """The markers of one topic: what is shown now, and what viewers still have to forget."""

    def __init__(self) -> None:
        self._shown: set[tuple[str, int]] = set()

    @property
    def is_empty(self) -> bool:
        """Whether viewers were shown nothing that they still have."""
        return not self._shown

    def show(
        self,
        mixture: GaussianMixture,
        activations: Array,
        frames: Mapping[str, Frame],
        nanoseconds: int,
        frame_id: str,
    ) -> MarkerArray:
        """Markers of one moment, and the deletion of those of former ones that are gone.

        Parameters
        ----------
        mixture
            the adapted components over poses and whatever else the model encodes
        activations
            (K,), how much each component takes part now; shown by its opacity
        frames
            the frames that took part, over [time, pose]

        Returns
        -------
        MarkerArray
            the markers
        """
        header = conversions.header_at(nanoseconds, frame_id)
        added = _markers(mixture, activations, frames, header)
        for marker in added:
            marker.lifetime = LIFETIME
        shown = {(marker.ns, marker.id) for marker in added}
        gone, self._shown = self._shown - shown, shown
        return MarkerArray(markers=[*_deletions(gone, header), *added])

    def clear(self, nanoseconds: int, frame_id: str) -> MarkerArray:
        """The deletion of all that is shown."""
        gone, self._shown = self._shown, set()
        return MarkerArray(markers=_deletions(gone, conversions.header_at(nanoseconds, frame_id)))


def _deletions(names: set[tuple[str, int]], header: Header) -> list[Marker]:
    return [Marker(header=header, ns=ns, id=number, action=Marker.DELETE) for ns, number in sorted(names)]


def _markers(mixture: GaussianMixture, activations: Array, frames: Mapping[str, Frame], header: Header) -> list[Marker]:
    sphere = mixture.manifold.spheres[0]  # the position stands before the orientation
    place = slice(sphere.ambient.start - 3, sphere.ambient.start)
    spread = slice(sphere.tangent.start - 3, sphere.tangent.start)
    markers = []
    for k, (mean, covariance) in enumerate(zip(mixture.means, mixture.covariances, strict=True)):
        values, vectors = np.linalg.eigh(covariance[spread, spread])
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        pose = np.concatenate([mean[place], quaternion.from_matrix(vectors)])
        marker = Marker(header=header, ns="components", id=k, type=Marker.SPHERE, action=Marker.ADD)
        marker.pose = conversions.pose_from_array(pose)
        # Two standard deviations to each side.
        marker.scale.x, marker.scale.y, marker.scale.z = (4.0 * np.sqrt(np.maximum(values, 1e-8))).tolist()
        marker.color = ColorRGBA(r=0.9, g=0.5, b=0.1, a=float(0.15 + 0.6 * activations[k]))
        markers.append(marker)
    path = Marker(header=header, ns="path", id=0, type=Marker.LINE_STRIP, action=Marker.ADD)
    path.scale.x = 0.004
    path.color = ColorRGBA(r=0.2, g=0.2, b=0.2, a=0.9)
    path.points = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in mixture.means[:, place]]
    return [*markers, path, *(_axes(name, frame, header) for name, frame in frames.items())]


def _axes(name: str, frame: Frame, header: Header) -> Marker:
    # Numbers by the order of the frames would change when one of them is not seen.
    marker = Marker(header=header, ns=f"frames/{name}", id=0, type=Marker.LINE_LIST, action=Marker.ADD, text=name)
    marker.scale.x = 0.006
    origin = frame.b[1:4]
    for axis, color in zip(frame.A[1:4, 1:4].T, _AXES, strict=True):
        for point in (origin, origin + _AXIS_LENGTH * axis):
            marker.points.append(Point(x=float(point[0]), y=float(point[1]), z=float(point[2])))
            marker.colors.append(color)
    return marker

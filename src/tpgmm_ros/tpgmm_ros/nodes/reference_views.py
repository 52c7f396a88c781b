# SPDX-License-Identifier: Apache-2.0
"""What `reproduction` shows to people, more rarely than references come: a pose, transforms, markers, its status."""

from __future__ import annotations

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from visualization_msgs.msg import MarkerArray

from tpgmm_core.common.text import listed
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.skill_sequence import SkillSequence
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.broadcasting import TransformBroadcaster
from tpgmm_ros.messages.markers import Scene
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.nodes.movements import Movements
from tpgmm_ros.runtime.lifecycle import ManagedNode
from tpgmm_ros.task.task_file import Task

TRACKER_TIMEOUT = 1.0  # s
POSE_PERIOD_NS = 33_000_000
MARKER_PERIOD_NS = 100_000_000
#: The course ahead is shown this often, ns: so many Gaussians, so far apart, s.
AHEAD_PERIOD_NS, AHEAD_STEPS, AHEAD_TIME_STEP = 200_000_000, 12, 0.2


class Seldom:
    """What is to be done once in a period, by the stamps of steps.

    Parameters
    ----------
    period_ns
        ns
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns, self._done_ns = period_ns, -period_ns

    def is_due(self, stamp_ns: int) -> bool:
        """Whether to do it now; then it is done."""
        if 0 <= stamp_ns - self._done_ns < self._period_ns:
            return False
        self._done_ns = stamp_ns
        return True


class ReferenceViews:
    """Publishes references of poses as viewers understand them.

    Parameters
    ----------
    node
        while it is configured
    task
        of the references
    with_transforms
        whether they go on /tf too
    """

    def __init__(self, node: ManagedNode, task: Task, with_transforms: bool) -> None:
        self._task = task
        self._poses = node.create_lifecycle_publisher(PoseWithCovarianceStamped, "reference_pose", STREAM)
        self._markers = node.create_lifecycle_publisher(MarkerArray, "markers", STREAM)
        self._ahead = node.create_lifecycle_publisher(ReferenceMessage, "reference_ahead", STREAM)
        self._transforms = TransformBroadcaster(node) if with_transforms else None
        self._scene = Scene()
        self._pose_due, self._markers_due = Seldom(POSE_PERIOD_NS), Seldom(MARKER_PERIOD_NS)
        self._ahead_due = Seldom(AHEAD_PERIOD_NS)

    def show(self, stamp_ns: int, sequence: SkillSequence, reference: Reference) -> None:
        """The reference of a sequence at a time, ns, where it is one of poses."""
        frame_id = self._task.base_frame
        if reference.gaussian.manifold != POSE:
            return
        if self._pose_due.is_due(stamp_ns):
            self._poses.publish(conversions.pose_with_covariance(reference.gaussian, stamp_ns, frame_id))
            if self._transforms is not None:
                pose = {(frame_id, f"{self._task.name}/reference"): reference.gaussian.mean}
                self._transforms.send(stamp_ns, pose)
        if self._markers.get_subscription_count() and self._markers_due.is_due(stamp_ns):
            mixture = sequence.execution.retrieval.mixture()
            shown = self._scene.show(mixture, reference.activations, sequence.frames, stamp_ns, frame_id)
            self._markers.publish(shown)
        if self._ahead_due.is_due(stamp_ns) and self._ahead.get_subscription_count():
            horizon = tuple(sequence.execution.retrieval.horizon(AHEAD_STEPS, AHEAD_TIME_STEP))
            ahead = replace(reference, horizon_time_step=AHEAD_TIME_STEP, horizon=horizon)
            dimensions = self._task.space.state_dimensions()
            self._ahead.publish(conversions.reference_message(ahead, dimensions, stamp_ns, frame_id))

    def hide(self, stamp_ns: int) -> None:
        """Nothing is reproduced any more, at a time, ns: viewers forget what they were shown."""
        if not self._scene.is_empty:
            self._markers.publish(self._scene.clear(stamp_ns, self._task.base_frame))


def reproduction_status(movements: Movements | None, silence: float) -> tuple[bytes, str, dict[str, str]]:
    """What `/diagnostics` says of a movement.

    Parameters
    ----------
    movements
        of the node; None while it is not configured
    silence
        since task parameters came, s

    Returns
    -------
    tuple[bytes, str, dict[str, str]]
        level, message and values
    """
    sequence = None if movements is None else movements.sequence
    if movements is None or sequence is None:
        return DiagnosticStatus.OK, "waiting for a request", {}
    execution, frames = sequence.execution, sequence.frames
    reference = execution.reference
    values = {"stage": execution.stage.value, "frames": ", ".join(frames)}
    if len(sequence.skills) > 1:
        values["skill"] = f"{sequence.index + 1} of {len(sequence.skills)}: {sequence.name}"
    if reference is not None:
        values["phase"] = f"{reference.phase:.3f}"
    if movements.novelty is not None:
        values["novelty"] = f"{movements.novelty.score:.2f}"
        values["novelty_percentile"] = f"{100.0 * movements.novelty.percentile:.0f}"
    if silence > TRACKER_TIMEOUT:
        return (
            DiagnosticStatus.ERROR,
            f"no task parameters for {silence:.1f} s; check that frame_tracker is running",
            values,
        )
    if reference is not None and reference.waits:
        return DiagnosticStatus.WARN, f"waits: {reference.waits}", values
    missing = [name for name in execution.retrieval.frame_names if name not in frames]
    if missing:
        return DiagnosticStatus.WARN, f"reproducing without {listed(missing)}", values
    return DiagnosticStatus.OK, "reproducing", values

# SPDX-License-Identifier: Apache-2.0
"""recognition: poses of a hand and of the frames in; which skill is being shown, and where the hand goes, out."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String
from std_srvs.srv import Trigger

from tpgmm_core.common.text import shown
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.recognition.recognizer import UNKNOWN, Recognition, RecognitionConfig, Recognizer
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.basic_messages import pose_with_covariance
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.models.known_skills import load_skills
from tpgmm_ros.models.task_model import known_frames
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters, declared_of
from tpgmm_ros.task.task_file import Task

PARAMETERS = [
    Declared("task_file", "", "Task file (YAML): frames, and the topic of the hand", fixed=True),
    Declared("skills", [""], "Skills: NAME=FILE with a model of these frames, or NAME=FILE=PRIOR", fixed=True),
    Declared("ahead", 0.5, "How far ahead the position of the hand is predicted, s", 0.0, 60.0),
    *(replace(declared, fixed=True) for declared in declared_of(RecognitionConfig)),
]


class RecognitionNode(Node):
    """Publishes what the core's `Recognizer` finds, once for each pose of the hand."""

    def __init__(self) -> None:
        super().__init__("recognition")
        self.parameters = Parameters(self, PARAMETERS)
        self.task = Task.load(self.parameters.file("task_file"))
        named = [text for text in self.parameters["skills"] if text]
        config = self.parameters.fill(RecognitionConfig)
        self.recognizer = Recognizer(load_skills(named, self.task), config) if named else None
        self._task_parameters = TaskParameters()
        self._found: Recognition | None = None
        self._trouble = ""
        self._probabilities = self.create_publisher(Float64MultiArray, "recognition/probabilities", STREAM)
        self._skill = self.create_publisher(String, "recognition/skill", LATCHED)
        self._ahead = self.create_publisher(PoseWithCovarianceStamped, "recognition/prediction", STREAM)
        self._end = self.create_publisher(PoseWithCovarianceStamped, "recognition/end", STREAM)
        names = [*(self.recognizer.names if self.recognizer else ()), UNKNOWN]
        dimension = MultiArrayDimension(label=",".join(names), size=len(names), stride=len(names))
        self._layout = MultiArrayLayout(dim=[dimension])
        self.create_subscription(TaskParameters, "task_parameters", self._take_frames, LATCHED)
        self.create_subscription(PoseStamped, self.task.movement, self._take_pose, STREAM)
        self.create_service(Trigger, "recognition/restart", self._restart)
        self.monitor = Monitor(self, self._status, 100.0)

    def _take_frames(self, message: TaskParameters) -> None:
        self._task_parameters = message

    def _take_pose(self, message: PoseStamped) -> None:
        begin, stamp_ns = time.perf_counter(), conversions.time_to_ns(message.header.stamp)
        self.monitor.tick(stamp_ns)
        if self.recognizer is None:
            return
        try:
            if message.header.frame_id != self.task.base_frame:
                raise ValueError(
                    f"the pose of the hand is in the frame {shown(message.header.frame_id)}, expected "
                    f"{shown(self.task.base_frame)}"
                )
            pose, reason = check_pose(conversions.pose_to_array(message.pose))
            if pose is None:
                raise ValueError(f"the pose of the hand is refused: {reason}")
            known = known_frames(conversions.task_parameters(self._task_parameters))
            frames, weights = {name: f for name, (f, _) in known.items()}, {name: w for name, (_, w) in known.items()}
            found = self.recognizer.step(stamp_ns, pose, frames, weights)
            self._publish(self.recognizer, found, stamp_ns)
        except ValueError as error:  # a MessageError is one
            self._trouble = str(error)
            self.get_logger().warning(self._trouble, throttle_duration_sec=2.0)
            return
        self._trouble = ""
        self.monitor.done += 1
        self.monitor.step.add(time.perf_counter() - begin)

    def _publish(self, recognizer: Recognizer, found: Recognition, stamp_ns: int) -> None:
        former, self._found = self._found, found
        values = list(found.probabilities.values())
        self._probabilities.publish(Float64MultiArray(layout=self._layout, data=values))
        if former is None or former.most_probable != found.most_probable:
            self._skill.publish(String(data=found.most_probable))
        for publisher, ahead in ((self._ahead, self.parameters["ahead"]), (self._end, float("inf"))):
            if publisher.get_subscription_count() and (gaussian := recognizer.predict(ahead)) is not None:
                publisher.publish(pose_with_covariance(gaussian, stamp_ns, self.task.base_frame))

    def _restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.recognizer is not None:
            self.recognizer.start()
        response.success, response.message = self.recognizer is not None, "recognition starts again with the next pose"
        return response

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        if self.recognizer is None:
            return DiagnosticStatus.WARN, "no skills: start the node with the parameter 'skills'", {}
        if self._trouble:
            return DiagnosticStatus.WARN, self._trouble, {}
        if self._found is None:
            return DiagnosticStatus.WARN, f"no pose of the hand yet on {self.task.movement}", {}
        if not any(one.is_situated for one in self.recognizer.filters):
            return DiagnosticStatus.WARN, "no frame of the skills is known; check that frame_tracker is running", {}
        values = {f"probability_{name}": f"{p:.3f}" for name, p in self._found.probabilities.items()}
        return DiagnosticStatus.OK, f"most probable: {self._found.most_probable}", values


def main() -> int:
    """Run the node; returns the exit status."""
    return run(RecognitionNode)


if __name__ == "__main__":
    sys.exit(main())

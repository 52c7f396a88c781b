# SPDX-License-Identifier: Apache-2.0
"""The model in use and the movements that go on: what the action ``reproduce`` and the service ``load_model`` ask for.

Models are read, made ready and rehearsed in the background, while references go on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any

from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tpgmm_core import Frame, LearnedMixture
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.knowledge import KnowledgeConfig
from tpgmm_core.retrieval.novelty import Novelty
from tpgmm_core.retrieval.outcome import ExecutionConfig, Outcome
from tpgmm_core.retrieval.skill_sequence import QueuedSkill, SkillSequence
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.models.skill_request import Prepared, SkillRequest, newest, prepare, skill_requests
from tpgmm_ros.nodes.controller_words import ControllerWords
from tpgmm_ros.nodes.goals import Goals, finish
from tpgmm_ros.runtime.background import Background
from tpgmm_ros.runtime.parameters import Parameters
from tpgmm_ros.runtime.rclpy_workarounds import create_deferred_service
from tpgmm_ros.runtime.timing import clock_trouble
from tpgmm_ros.task.task_file import Task

RETRIEVAL_SETTINGS = ("retrieval", "phase", "speed", "horizon_steps", "horizon_time_step", "blend_time")
"""The parameters that a retrieval is made with."""

DEACTIVATED = "the node was deactivated"


class Movements:
    """Carries out one goal at a time for an active node: one movement, or several skills one after another.

    Parameters
    ----------
    node
        serves action and service
    task
        what models have to fit
    models
        in use, as long as no other is loaded: one, several whose movements go on at the same time, or none
    parameters
        of the node; RETRIEVAL_SETTINGS and those of ExecutionConfig and KnowledgeConfig
    why_silent
        called where no ticks come: why, in words
    controller
        what is said of the robot where it did not get to the end

    Attributes
    ----------
    sequence
        of the skills that go on or were the last ones; None before, and while the node is not active
    state
        (D,), where the robot is, as far as that is known: its pose, or its configuration
    novelty
        of the situation in which the movement was asked for, the largest of its skills; None where no model, or the
        frames, did not tell
    """

    def __init__(
        self,
        node: Node,
        task: Task,
        models: tuple[LearnedMixture, ...],
        parameters: Parameters,
        why_silent: Callable[[], str],
        controller: ControllerWords,
    ) -> None:
        self.sequence: SkillSequence | None = None
        self.state: Array | None = None
        self.novelty: Novelty | None = None
        self._node, self._task, self._models, self._parameters = node, task, models, parameters
        self._why_silent, self._controller = why_silent, controller
        self._known: Mapping[str, tuple[Frame, float]] = {}
        self._requests = [SkillRequest()]  # what the sequence was made of
        self._activation: object | None = None  # of the node, which a goal belongs to; None while it is not active
        self._last_ns: int | None = None  # of the movement that goes on
        # Ticks that stop are noticed by a clock that does not.
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._stepped_ns = 0
        self._background = Background(node)
        create_deferred_service(node, LoadModel, "load_model", self._load_model)
        self.goals = Goals(node, self._accept)

    def activate(self) -> None:
        """Take goals from now on."""
        self._activation = object()

    def deactivate(self) -> None:
        """Take no goals from now on, and end the movement that goes on."""
        self._activation = None
        self._end(DEACTIVATED)
        self.sequence = None

    def close(self) -> None:
        """Take action and background away."""
        self._background.close()
        self.goals.destroy()

    def set_speed(self, speed: float) -> None:
        """Of the movement that goes on, if one does.

        Raises
        ------
        ValueError
            for one that its method cannot go
        """
        if self.sequence is not None and self.sequence.outcome is None:
            self.sequence.set_speed(speed)

    def take_frames(self, known: Mapping[str, tuple[Frame, float]]) -> None:
        """These frames are known now, by name, and how far each is trusted."""
        self._known = known
        if self.sequence is not None:
            self.sequence.take_frames(known)

    def step(self, stamp_ns: int) -> Reference | None:
        """The reference at a time, ns; None where there is none."""
        if self.sequence is None:
            return None
        self._stepped_ns = self._steady.now().nanoseconds
        if self._last_ns is not None:
            jump = 1e-9 * (stamp_ns - self._last_ns)
            if jump < 0.0:
                self._end(f"time jumped backwards, by {-jump:.3f} s")
            elif jump > self._parameters["start_timeout"]:  # such a silence would have ended it too
                self._end(f"time jumped forwards, by {jump:.3f} s")
        self._last_ns = stamp_ns
        if self.goals.is_cancel_requested:
            self._end("canceled")
        try:
            reference = self.sequence.step(stamp_ns, self.state)
        except ValueError as error:  # a situation that the model cannot be adapted to: the controller holds, then damps
            self._node.get_logger().error(f"no reference can be given: {error}")
            self._end(f"no reference can be given: {error}")
            self.sequence = None
            return None
        self._report_end()
        return reference

    def watch(self) -> None:
        """To be called now and then: ticks that do not come cannot notice it themselves."""
        silence = 1e-9 * (self._steady.now().nanoseconds - self._stepped_ns)
        if self.goals.is_cancel_requested:
            self._end("canceled")
        if self.goals.is_going_on and silence > self._parameters["start_timeout"]:
            self._end(f"no joint states for {silence:.1f} s: {self._why_silent()}")

    def _prepare(self, requests: list[SkillRequest], then: Callable[[Future[list[Prepared]]], None]) -> None:
        """Read the models in files (the one in use where there is none) and make them ready."""
        settings: dict[str, Any] = {name: self._parameters[name] for name in RETRIEVAL_SETTINGS}
        settings["method"] = settings.pop("retrieval") or None
        limits = self._parameters["max_novelty"], self._parameters.fill(KnowledgeConfig)
        work = partial(prepare, requests, self._models, self._task, settings, self._known, self.state, *limits)
        self._background.run(work, then)

    @property
    def _request(self) -> SkillRequest:
        """What the present skill was made of."""
        return self._requests[self.sequence.index if self.sequence is not None else 0]

    def _load_model(self, request: LoadModel.Request) -> Future[LoadModel.Response]:
        answer: Future[LoadModel.Response] = Future()
        self._load(replace(self._request, path=request.path), answer)
        return answer

    def _load(self, request: SkillRequest, answer: Future[LoadModel.Response]) -> None:
        self._prepare([request], partial(self._use, request, answer))

    def _use(self, request: SkillRequest, answer: Future[LoadModel.Response], job: Future[list[Prepared]]) -> None:
        """Use a model from now on, also for the skill that goes on."""
        present = replace(self._request, path=request.path)
        if present != request:  # another one has begun meanwhile
            self._load(present, answer)
            return
        try:
            (prepared,) = job.result()
            if self.sequence is not None and self.sequence.outcome is None:
                self._go_on_with(self.sequence, prepared.skill)
        except (ValueError, OSError) as error:
            answer.set_result(LoadModel.Response(success=False, reason=one_line(error)))
            return
        self._models = prepared.models
        path = request.path
        loaded = f"loaded {one_line(path)}" if path else "the model in use was set up again with the current parameters"
        self._node.get_logger().info(loaded)
        answer.set_result(LoadModel.Response(success=True))

    def _go_on_with(self, sequence: SkillSequence, skill: QueuedSkill) -> None:
        frames, _ = skill.frames(self._known, sequence.start)
        unseen = [name for name in skill.retrieval.frame_names if name not in frames]
        if unseen:
            raise ValueError(f"the frames {listed(unseen)} are not seen, and a movement is being reproduced")
        sequence.take_over(skill, self.state, self._parameters["blend_time"])

    def _accept(self, goal: ServerGoalHandle) -> None:
        if self._activation is None:
            finish(goal, Outcome(False, "the node is not active: activate it first"))
            return
        asked = goal.request
        try:
            requests = skill_requests(asked.model, asked.duration, asked.models, asked.durations, asked.holds)
        except ValueError as error:
            finish(goal, Outcome(False, str(error)))
            return
        self._prepare(requests, partial(self._begin, goal, requests, self._activation))

    def _begin(
        self, goal: ServerGoalHandle, requests: list[SkillRequest], activation: object, job: Future[list[Prepared]]
    ) -> None:
        config, blend_time = self._parameters.fill(ExecutionConfig), self._parameters["blend_time"]
        try:
            if activation is not self._activation:
                raise ValueError(DEACTIVATED)
            prepared = job.result()
            sequence = SkillSequence([one.skill for one in prepared], config, blend_time, self.state)
        except (ValueError, OSError) as error:
            finish(goal, Outcome(False, str(error)))
            return
        if goal.is_cancel_requested:
            finish(goal, Outcome(False, "canceled"))
            return
        self._end("another movement was requested")
        self.goals.begin(goal)
        self.sequence, self._requests = sequence, requests
        self.novelty = newest(one.novelty for one in prepared)
        self._last_ns = None  # what the clock said before is no time to jump from
        self._controller.begin()
        self._stepped_ns = self._steady.now().nanoseconds
        self.take_frames(self._known)

    def _end(self, reason: str) -> None:
        """Stop the movement that goes on, if one does."""
        if self.sequence is not None:
            self.sequence.stop(self._last_ns or 0, reason)
            self._report_end()

    def _report_end(self) -> None:
        if self.sequence is None or self.sequence.outcome is None or not self.goals.is_going_on:
            return
        outcome = self.sequence.outcome
        trouble = clock_trouble(self._node)
        if not outcome.success and trouble not in outcome.reason:
            outcome = replace(outcome, reason=f"{outcome.reason}; {trouble}")
        if outcome.is_missed:
            outcome = replace(outcome, reason=f"{outcome.reason}; {self._controller.say()}")
        self.goals.end(outcome)

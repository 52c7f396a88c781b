# SPDX-License-Identifier: Apache-2.0
"""The model in use and the movement that goes on: what the action ``reproduce`` and the service ``load_model`` ask for.

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
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.execution import Execution, ExecutionConfig, Outcome, Stage
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.novelty import Novelty, NoveltyScale
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.models.task_model import load_task_model, make_task_retrieval
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

type Prepared = tuple[LearnedMixture, Retrieval, DerivedFrames, Novelty | None]
"""A model, a movement of it that has not begun yet, its frames that are not observed by themselves, and how new to it
the situation is, where that can be told."""


class Movements:
    """Carries out one movement at a time for an active node.

    Parameters
    ----------
    node
        serves action and service
    task
        what models have to fit
    model
        the one in use, as long as no other is loaded; None without
    parameters
        of the node; RETRIEVAL_SETTINGS and those of ExecutionConfig
    why_silent
        called where no ticks come: why, in words
    controller
        what is said of the robot where it did not get to the end

    Attributes
    ----------
    execution
        of the movement that goes on or was the last one; None before, and while the node is not active
    frames
        the known ones that its model has learned from
    state
        (D,), where the robot is, as far as that is known: its pose, or its configuration
    novelty
        of the situation in which the movement was asked for; None where the model, or the frames, did not tell
    """

    def __init__(
        self,
        node: Node,
        task: Task,
        model: LearnedMixture | None,
        parameters: Parameters,
        why_silent: Callable[[], str],
        controller: ControllerWords,
    ) -> None:
        self.execution: Execution | None = None
        self.frames: dict[str, Frame] = {}
        self.state: Array | None = None
        self.novelty: Novelty | None = None
        self._node, self._task, self._model, self._parameters = node, task, model, parameters
        self._why_silent, self._controller = why_silent, controller
        self._known: Mapping[str, tuple[Frame, float]] = {}
        self._weights: dict[str, float] = {}
        self._derived = DerivedFrames()  # of the model that is reproduced
        self._start: Array | None = None  # where the robot was when the movement was asked for
        self._duration = 0.0
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
        self.execution = None

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
        if self.execution is not None and self.execution.stage is not Stage.ENDED:
            self.execution.retrieval.speed = speed

    def take_frames(self, known: Mapping[str, tuple[Frame, float]]) -> None:
        """These frames are known now, by name, and how far each is trusted."""
        self._known = known
        if self.execution is not None:
            self.frames, self._weights = those_of(self.execution.retrieval, known, self._derived, self._start)

    def step(self, stamp_ns: int) -> Reference | None:
        """The reference at a time, ns; None where there is none."""
        if self.execution is None:
            return None
        self._stepped_ns = self._steady.now().nanoseconds
        if self._last_ns is not None:
            jump = 1e-9 * (stamp_ns - self._last_ns)
            if jump < 0.0:
                self._end(f"time jumped backwards, by {-jump:.3f} s")
            elif jump > self._parameters["start_timeout"]:  # such a silence would have ended it too
                self._end(f"time jumped forwards, by {jump:.3f} s")
        self._last_ns = stamp_ns
        if self._start is None and self.state is not None:  # not known when the movement was asked for
            self._start = self.state
            self.take_frames(self._known)
        if self.goals.is_cancel_requested:
            self._end("canceled")
        try:
            reference = self.execution.step(stamp_ns, self.frames, self.state, self._weights)
        except ValueError as error:  # a situation that the model cannot be adapted to: the controller holds, then damps
            self._node.get_logger().error(f"no reference can be given: {error}")
            self._end(f"no reference can be given: {error}")
            self.execution = None
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

    def _prepare(self, path: str, duration: float, then: Callable[[Future[Prepared]], None]) -> None:
        """Read the model in a file (the one in use where there is none) and make it ready."""
        task, model, known, state = self._task, self._model, self._known, self.state
        settings: dict[str, Any] = {name: self._parameters[name] for name in RETRIEVAL_SETTINGS}
        method, most = settings.pop("retrieval") or None, self._parameters["max_novelty"]

        def work() -> Prepared:
            chosen = load_task_model(path, task) if path else model
            if chosen is None:
                raise ValueError("no model is loaded: name a model file in the goal, or set the parameter model_file")
            retrieval = make_task_retrieval(chosen, task, method, duration=duration or None, **settings)
            derived = DerivedFrames.of_metadata(chosen.metadata_)
            frames, weights = those_of(retrieval, known, derived, state)
            if frames and not (state is None and task.space.needs_state):
                # a rehearsal: what cannot be adapted to the situation is refused before anything depends on it
                retrieval.start(0, state)
                retrieval.step(0, frames, state, weights)
            return chosen, retrieval, derived, _judged(chosen, retrieval, frames, state, most)

        self._background.run(work, then)

    def _load_model(self, request: LoadModel.Request) -> Future[LoadModel.Response]:
        answer: Future[LoadModel.Response] = Future()
        self._prepare(request.path, self._duration, partial(self._use, request.path, self._duration, answer))
        return answer

    def _use(self, path: str, duration: float, answer: Future[LoadModel.Response], job: Future[Prepared]) -> None:
        """Use a model from now on, also for the movement that goes on."""
        if duration != self._duration:  # another movement has begun meanwhile
            self._prepare(path, self._duration, partial(self._use, path, self._duration, answer))
            return
        try:
            model, retrieval, derived, _ = job.result()
            if self.execution is not None and self.execution.stage is not Stage.ENDED:
                self._go_on_with(self.execution, retrieval, derived)
        except (ValueError, OSError) as error:
            answer.set_result(LoadModel.Response(success=False, reason=one_line(error)))
            return
        self._model = model
        loaded = f"loaded {one_line(path)}" if path else "the model in use was set up again with the current parameters"
        self._node.get_logger().info(loaded)
        answer.set_result(LoadModel.Response(success=True))

    def _go_on_with(self, execution: Execution, retrieval: Retrieval, derived: DerivedFrames) -> None:
        frames, _ = those_of(retrieval, self._known, derived, self._start)
        unseen = [name for name in retrieval.frame_names if name not in frames]
        if unseen:
            raise ValueError(f"the frames {listed(unseen)} are not seen, and a movement is being reproduced")
        execution.take_over(retrieval, self.state, self._parameters["blend_time"])
        self._derived = derived
        self.take_frames(self._known)

    def _accept(self, goal: ServerGoalHandle) -> None:
        if self._activation is None:
            finish(goal, Outcome(False, "the node is not active: activate it first"))
        else:
            then = partial(self._begin, goal, self._activation)
            self._prepare(goal.request.model, goal.request.duration, then)

    def _begin(self, goal: ServerGoalHandle, activation: object, job: Future[Prepared]) -> None:
        try:
            if activation is not self._activation:
                raise ValueError(DEACTIVATED)
            _, retrieval, derived, self.novelty = job.result()
        except (ValueError, OSError) as error:
            finish(goal, Outcome(False, str(error)))
            return
        if goal.is_cancel_requested:
            finish(goal, Outcome(False, "canceled"))
            return
        self._end("another movement was requested")
        self.goals.begin(goal)
        self.execution = Execution(retrieval, self._parameters.fill(ExecutionConfig))
        self._derived, self._start = derived, self.state
        self._duration = goal.request.duration
        self._last_ns = None  # what the clock said before is no time to jump from
        self._controller.begin()
        self._stepped_ns = self._steady.now().nanoseconds
        self.take_frames(self._known)

    def _end(self, reason: str) -> None:
        """Stop the movement that goes on, if one does."""
        if self.execution is not None:
            self.execution.stop(self._last_ns or 0, reason)
            self._report_end()

    def _report_end(self) -> None:
        if self.execution is None or self.execution.outcome is None or not self.goals.is_going_on:
            return
        outcome = self.execution.outcome
        trouble = clock_trouble(self._node)
        if not outcome.success and trouble not in outcome.reason:
            outcome = replace(outcome, reason=f"{outcome.reason}; {trouble}")
        if outcome.is_missed:
            outcome = replace(outcome, reason=f"{outcome.reason}; {self._controller.say()}")
        self.goals.end(outcome)


def _judged(
    model: LearnedMixture, retrieval: Retrieval, frames: Mapping[str, Frame], state: Array | None, most: float
) -> Novelty | None:
    """How new a situation is. With a limit `most` above 0, ValueError beyond it, and where that cannot be told."""
    scale = NoveltyScale.of_model(model)
    unseen = [name for name in retrieval.frame_names if name not in frames]
    if scale is None or unseen:
        if most > 0.0 and scale is None:
            raise ValueError(
                "max_novelty is set, but the model does not say what is new to it: train it with --leave-one-out"
            )
        if most > 0.0:
            raise ValueError(f"max_novelty is set, but how new the situation is needs the frames {listed(unseen)}")
        return None
    novelty = scale.judge(retrieval, frames, state)
    if 0.0 < most < novelty.score:
        raise ValueError(
            f"the situation is too new to the model: novelty {novelty.score:.2g}, max_novelty is {most:.2g}; {novelty}"
        )
    return novelty


def those_of(
    retrieval: Retrieval,
    known: Mapping[str, tuple[Frame, float]],
    derived: DerivedFrames,
    start: Array | None,
) -> tuple[dict[str, Frame], dict[str, float]]:
    """Those of the known frames that a model has learned from, derived ones included.

    Parameters
    ----------
    retrieval
        names the frames of the model
    known
        name → frame, and how far it is trusted
    derived
        frames that are made of others
    start
        where the hand was when the movement began; None where not known

    Returns
    -------
    tuple[dict[str, Frame], dict[str, float]]
        frames by name, and how far each is trusted
    """
    frames = {name: frame for name, (frame, _) in known.items()}
    weights = {name: weight for name, (_, weight) in known.items()}
    frames |= derived.frames(frames, start)
    weights |= derived.weights(weights)
    names = [name for name in retrieval.frame_names if name in frames]
    return {name: frames[name] for name in names}, {name: weights[name] for name in names}

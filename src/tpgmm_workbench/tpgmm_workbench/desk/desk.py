# SPDX-License-Identifier: Apache-2.0
"""`Desk`: what a user may ask for, obeyed or refused in words, and what is known at one moment.

All methods are called in the executor's thread, and return at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from rclpy.node import Node

from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.desk.coaching import Coaching
from tpgmm_workbench.desk.learning import Learning
from tpgmm_workbench.desk.novelty import RunNovelty
from tpgmm_workbench.desk.pace import Pace
from tpgmm_workbench.desk.pictures import Pictures
from tpgmm_workbench.desk.said import Said
from tpgmm_workbench.desk.sharing import Sharing
from tpgmm_workbench.desk.table import SimulatedTable, simulated_world
from tpgmm_workbench.desk.teaching import Teaching
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.graph.movement import MovementClient
from tpgmm_workbench.graph.watching import Watcher
from tpgmm_workbench.project.activities import Action, Activity, Facts, may
from tpgmm_workbench.project.preview import Preview
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.training import TrainingOptions
from tpgmm_workbench.session.view import GraphView

#: An arm that is held is given so long to become free before a recording begins anyway, s.
RELEASE = 4.0


class Desk:
    """The workbench without its page.

    Parameters
    ----------
    node
        talks to the graph
    project
        what is taught, and learned
    simulated
        whether the robot is a simulation, whose hand may be dragged and whose objects may be moved
    seed
        of the places of a simulation's objects; None: others each time
    coach_force
        on the hand, from which on a correction begins by itself while the skill runs, N; 0: never

    Attributes
    ----------
    robot
        its kinematics
    home
        (7,) the hand's pose at the robot's home
    table
        what only a simulation lets a user do
    sharing, pictures
        exports, imports; pictures of the scene
    say
        tells the user something, and the log
    teaching
        the demonstrations, what is noted about them, and where to show the next one
    """

    def __init__(
        self, node: Node, project: Project, simulated: bool, seed: int | None = None, coach_force: float = 0.0
    ) -> None:
        self.project, self.simulated = project, simulated
        self.robot, self._said = project.robot(), Said(node)
        self.say = self._said.say
        self._background, self._judge, self._waiting = (Background(node) for _ in range(3))
        self._watcher = Watcher(node, project.task, self.robot, feels=coach_force > 0.0)
        self._movement = MovementClient(node, self.say)
        self._learning = Learning(project, self._background, self.say)
        # a correction is a demonstration with a model of its own: both come, and are taken back, at once
        self.teaching = Teaching(node, project, self._judge, self.say, self._learning.refresh)
        self._coaching = Coaching(project, self._background, self.say, self.teaching.refresh, simulated, coach_force)
        self._novelty = RunNovelty(project, self._judge)
        self.sharing = Sharing(project, self._background, self._refused, self.say)
        self.pictures = Pictures(project, self._waiting, self.say)
        data = self.robot.create_data()
        data.update(self.robot.home)
        self.home = data.pose(project.task.endpoint).copy()
        world = simulated_world(node, project, self.robot, self.home, seed) if simulated else None
        self.table = SimulatedTable(world, self.home, self._movement, self._refused, self.say)
        self._graph, self._is_read = GraphView(), False
        self._pace, self._duration, self._stops = Pace(self._movement), 0.0, 0
        self._release_until: float | None = None

    def close(self) -> None:
        """End what goes on, in order; what was recorded is kept."""
        self._movement.stop()
        self.teaching.close()
        self._learning.close()
        for background in (self._background, self._judge, self._waiting):
            background.close()
        self._watcher.close()

    # -- what is known ------------------------------------------------------------------------------------------------

    @property
    def activity(self) -> Activity:
        """What is going on."""
        if self.teaching.is_recording or self._release_until is not None:
            return Activity.TEACHING
        if self._movement.view.goes_on:
            if self._coaching.is_on:
                return Activity.COACHING
            return Activity.PAUSED if self._pace.is_paused else Activity.RUNNING
        return Activity.IDLE

    def facts(self, drives: bool = True) -> Facts:
        """What the rules ask about; `drives`: whether who asks is the one that drives."""
        graph, controller = self._graph, self._graph.controller
        return Facts(
            activity=self.activity,
            demonstrations=self.teaching.used,
            has_model=self._learning.model is not None,
            is_training=self._learning.is_training,
            can_undo=self.teaching.can_undo,
            can_redo=self.teaching.can_redo,
            is_read=self.teaching.is_read and self._learning.is_read,
            has_robot=graph.joints is not None,
            missing_frames=tuple(frame.name for frame in graph.frames if frame.pose is None),
            is_simulated=self.simulated,
            fault=controller.reason if controller is not None and controller.state == "FAULT" else "",
            drives=drives,
        )

    def look(self) -> DeskView:
        """What is known now; to be called up to thirty times per second."""
        self._graph = self._watcher.look()
        if not self._is_read:  # not before: outcomes of the background come to a node that is served, and are lost else
            self._is_read = True
            self.teaching.refresh()
        self._learning.look()
        self._coaching.watch(self._movement.view, self._graph, self.table.aim is not None)
        self._pace.watch(self._movement.view, self._graph, self._coaching.is_on)
        self._novelty.watch(self._coaching.model if self._movement.view.goes_on else None, self._graph)
        self._begin_when_free()
        self.table.watch(self._graph)
        facts = self.facts()
        return DeskView(
            graph=self._graph,
            run=self._movement.view,
            activity=facts.activity,
            taught=self.teaching.shown,
            suggested=self.teaching.suggested,
            lasted=self.teaching.lasted,
            progress=self._learning.progress,
            model=self._learning.model,
            preview=self._learning.shown,
            novelty=self._novelty.view,
            reasons={action: may(action, facts) for action in Action},
            words=self._said.recent,
            coached=self._coaching.words,
            coach_force=self._coaching.touch.threshold,
            may_grab=self._coaching.touch.is_ready,
            shared=self.sharing.words,
            pictured=self.pictures.words,
            places=self.table.places,
            hidden=self.table.hidden,
            aim=self.table.aim,
            to_go=self.table.to_go,
            is_paused=self._pace.is_paused,
            waits=self._pace.words,
            speed=self._pace.speed,
            duration=self._duration,
        )

    def _refused(self, action: Action) -> bool:
        """Whether something may not be done now; then the user is told why."""
        reason = may(action, self.facts())
        if reason:
            self.say(reason)
        return bool(reason)

    # -- teach --------------------------------------------------------------------------------------------------------

    def record(self) -> None:
        """Begin a demonstration, as soon as nothing holds the arm."""
        if self._refused(Action.RECORD):
            return
        controller = self._graph.controller
        if controller is not None and controller.state in ("ACTIVE", "HOLD"):
            self._movement.let_go()
            self._release_until = time.monotonic() + RELEASE
        else:
            self.teaching.begin()

    def _begin_when_free(self) -> None:
        if self._release_until is None:
            return
        controller = self._graph.controller
        held = controller is not None and controller.state in ("ACTIVE", "HOLD")
        if not held or time.monotonic() > self._release_until:
            self._release_until = None
            self.teaching.begin()

    def end_recording(self) -> None:
        """End the demonstration, and keep it."""
        if not self._refused(Action.END_RECORDING):
            self._release_until = None
            self.teaching.end()

    def undo(self) -> None:
        """Take the last demonstration back, or the last correction with its model."""
        if not self._refused(Action.UNDO):
            self._coaching.words = ""
            self.teaching.undo()

    def redo(self) -> None:
        """Bring back what was undone last."""
        if not self._refused(Action.REDO):
            self.teaching.redo()

    def lay_as_suggested(self) -> None:
        """Lay a simulation's objects where the next demonstration should be."""
        if self.teaching.suggested is not None:
            self.table.lay(self.teaching.suggested.frames)

    # -- learn, look ahead, run ---------------------------------------------------------------------------------------

    def train(self, is_automatic: bool = True) -> None:
        """Learn from all demonstrations that are used; `is_automatic`: method and settings are chosen."""
        if not self._refused(Action.TRAIN):
            self._learning.train(TrainingOptions(is_automatic=is_automatic))

    def cancel_training(self) -> None:
        """End the training."""
        if not self._refused(Action.CANCEL_TRAINING):
            self._learning.cancel()

    def preview(self) -> None:
        """See where the skill would go."""
        if not self._refused(Action.PREVIEW):
            self._look_ahead(lambda shown: self.say(f"preview: {shown.words}"))

    def _look_ahead(self, then: Callable[[Preview], object]) -> None:
        if self._learning.is_previewing:
            self.say("a preview is being computed: try again when its result is there")
        if self._learning.is_previewing or self._graph.joints is None:
            return
        frames = {frame.name: frame.pose for frame in self._graph.frames if frame.pose is not None}
        self._learning.preview(frames, self._graph.joints, self._duration or None, then)

    def run(self) -> None:
        """Run the skill, where its preview says that it can; go on after a pause."""
        if self._refused(Action.RUN):
            return
        if self.activity is Activity.PAUSED:
            self._pace.set(self._pace.speed)
            return
        self.table.let_go()
        self._look_ahead(partial(self._run_if_good, self._stops))

    def _run_if_good(self, stops: int, shown: Preview) -> None:
        if stops != self._stops or not shown.may_run:
            self.say(f"not run: {shown.words if stops == self._stops else 'stopped before it began'}")
            return
        if self._learning.model is not None and not self._refused(Action.RUN):
            self._pace.begin()
            self._coaching.model = self._learning.model.number
            self._movement.start(self._learning.model.path, self._duration)

    def pause(self) -> None:
        """Stand still; `run` goes on."""
        if not self._refused(Action.PAUSE):
            self._pace.pause()

    def coach(self) -> None:
        """Take what the hand is led to while the skill runs as a correction; nothing moves by itself."""
        if not self._refused(Action.COACH):
            self._coaching.begin()

    def end_coaching(self) -> None:
        """Let go of the hand; the correction is learned as soon as the movement is over."""
        if not self._refused(Action.END_COACHING):
            self.table.let_go()
            self._coaching.end()

    def set_speed(self, speed: float) -> None:
        """Run at this speed; 1: as learned, below 0: back."""
        self._pace.set(speed)

    def set_duration(self, duration: float) -> None:
        """Let the next movement take so long, s; 0: as taught."""
        self._duration = duration
        self._learning.shown = None

    def stop(self) -> None:
        """Stop the robot where it is; may always be asked for. A recording goes on until it is ended."""
        self._stops += 1
        self._movement.stop()
        self.table.let_go()
        self._pace.is_paused = False

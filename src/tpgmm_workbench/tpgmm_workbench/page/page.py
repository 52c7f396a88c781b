# SPDX-License-Identifier: Apache-2.0
"""The page: a scene and panels that show a `DeskView`, served by viser, to this machine alone if not told otherwise.

What a user asks for is put in a queue, which the node works off: a page never calls ROS, and never waits for it.
"""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from viser import ClientHandle, ViserServer

from tpgmm_core.common.types import Array
from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page import words
from tpgmm_workbench.page.access import Access, guarded
from tpgmm_workbench.page.added import completed
from tpgmm_workbench.page.camera import camera_for
from tpgmm_workbench.page.controls import Text
from tpgmm_workbench.page.driver import Driver
from tpgmm_workbench.page.own_thread import Newest, in_own_thread
from tpgmm_workbench.page.panels import NodesPanel, RobotPanel, RunPanel, TeachPanel, TrainPanel
from tpgmm_workbench.page.share_panel import SharePanel
from tpgmm_workbench.page.stop_panel import StopPanel
from tpgmm_workbench.project.preview import Preview
from tpgmm_workbench.scene.colors import PREVIEW
from tpgmm_workbench.scene.frames_display import FramesDisplay
from tpgmm_workbench.scene.hand_display import HandDisplay
from tpgmm_workbench.scene.heard import in_order
from tpgmm_workbench.scene.model_display import ModelDisplay
from tpgmm_workbench.scene.robot_display import RobotDisplay
from tpgmm_workbench.scene.shapes import Shapes
from tpgmm_workbench.scene.stiffness_display import StiffnessDisplay
from tpgmm_workbench.scene.suggested_display import SuggestedDisplay

#: Texts and trail are renewed this often, s; a ghost moves through its movement in this time, s.
TEXT_PERIOD, GHOST_TIME = 0.2, 4.0


class Page:
    """The page.

    Parameters
    ----------
    desk
        what the user may ask for
    ask
        called from any thread with a method of the desk and its arguments
    shapes
        what the robot looks like
    port
        where it is served; the next free one where it is taken
    access
        at which address it is served, and who may see it

    Attributes
    ----------
    address
        where it is; with a token where one is needed: for the user's eyes alone
    """

    def __init__(self, desk: Desk, ask: Callable[..., object], shapes: Shapes, port: int, access: Access) -> None:
        self._access = access
        self._desk, self._give, self._shapes = desk, ask, shapes
        self.driver = Driver()
        with (
            guarded(access, completed),
            contextlib.redirect_stdout(io.StringIO()),
        ):  # viser draws a box with an address; ours is said by the node
            self._server = server = ViserServer(access.host, port, label="tpgmm workbench", verbose=False)
        # nothing of this page goes to another machine, whatever a client asks for
        server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        self.address = access.address(server.get_port())
        self._dress(dark=False)
        self._make_scene(server)
        self._make_panels(server)
        self._views = Newest(server, self._show)
        server.on_client_connect(self._come)
        server.on_client_disconnect(self._go)
        self._text_due = 0.0

    def _make_scene(self, server: ViserServer) -> None:
        desk, scene = self._desk, server.scene
        camera = camera_for(desk.home)
        server.initial_camera.look_at = tuple(camera.look_at)
        server.initial_camera.position = tuple(camera.position)
        server.initial_camera.fov = camera.fov
        # shadows and reflections would cost more than all of the rest where a browser draws without a graphics card
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(hdri=None)
        scene.add_light_ambient("/ambient", intensity=1.2)
        scene.add_grid("/floor", width=4.0, height=4.0, position=(0.0, 0.0, self._lowest()), cell_size=0.25)
        self._robot = RobotDisplay(scene, desk.robot, self._shapes)
        self._ghost: RobotDisplay | None = None
        self._shown: Preview | None = None
        self._shown_since = 0.0
        draggable = desk.project.task.topics if desk.simulated else ()
        self._frames = FramesDisplay(scene, list(desk.project.task.frames), draggable, self._move)
        self._hand = HandDisplay(scene, self._lead if desk.simulated else None)
        self._model = ModelDisplay(scene)
        self._suggested = SuggestedDisplay(scene, list(desk.project.task.sources))
        self._stiffness = StiffnessDisplay(scene)

    def _dress(self, dark: bool) -> None:
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", dark_mode=dark
        )

    def _lowest(self) -> float:
        """Where the floor is: below all of the robot, m."""
        data = self._desk.robot.create_data()
        data.update(self._desk.robot.home)
        known = [part for part in self._shapes.parts if self._desk.robot.pinocchio.existFrame(part.link)]
        heights = [
            float(data.frame_pose(self._desk.robot.frame_id(part.link))[2]) - float(np.abs(part.vertices).max())
            for part in known
        ]
        return max(min(heights, default=0.0), -1.0)

    def _make_panels(self, server: ViserServer) -> None:
        desk = self._desk
        self._stop = StopPanel(server, self._stop_robot)
        self._told: dict[int, Text] = {}
        self._take_over = server.gui.add_button("Drive from this page", visible=False)
        self._take_over.on_click(in_order(lambda event: self.driver.take_over(event.client_id)))
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Teach"):
            teach = TeachPanel(server, desk, self.ask)
        with tabs.add_tab("Train"):
            train = TrainPanel(server, desk, self.ask)
        with tabs.add_tab("Run"):
            run = RunPanel(server, desk, self.ask)
        with tabs.add_tab("Robot"):
            robot = RobotPanel(server)
        with tabs.add_tab("Share"):
            share = SharePanel(server, desk, self.ask, self._give)
        with tabs.add_tab("Nodes"):
            nodes = NodesPanel(server)
            dark = server.gui.add_checkbox("dark", False)
            dark.on_update(in_order(lambda event: self._dress(bool(event.target.value))))
        self._panels = (teach, train, run, robot, share, nodes)

    # -- who asks -----------------------------------------------------------------------------------------------------

    async def _come(self, client: ClientHandle) -> None:
        self.driver.come(client.client_id)
        told = Text(client, order=-1.0)  # this page alone sees it, and from now on it is heard
        self._tell(client.client_id, told)
        self._told[client.client_id] = told

    def _tell(self, page: int, told: Text) -> None:
        told.show(words.pages(self.driver.pages, self.driver.number, page, is_open=bool(self._access.token)))

    async def _go(self, client: ClientHandle) -> None:
        self._told.pop(client.client_id, None)
        if self.driver.go(client.client_id):  # the person who held the hand is gone
            self._frames.let_go()
            self._hand.let_go()
            self._give(self._desk.table.let_go)

    def _stop_robot(self) -> None:
        """From any page; a drag of the hand that goes on leads it no more: it has to be taken hold of again."""
        self._hand.let_go()
        self._give(self._desk.stop)

    def ask(self, page: int | None, method: Callable[..., object], *arguments: Any) -> None:
        """Ask for something, as the page of a number; the pages that do not drive are told so."""
        if self.driver.drives(page):
            self._give(method, *arguments)
            return
        client = self._server.get_clients().get(page) if page is not None else None
        if client is not None:
            words = "Another page drives", "Press “Drive from this page” to take over."
            in_own_thread(self._server, partial(client.add_notification, *words, auto_close_seconds=4.0))

    def _move(self, name: str, pose: Array, page: int | None) -> None:
        self.ask(page, self._desk.table.move_object, name, pose)

    def _lead(self, pose: Array, is_held: bool, page: int | None) -> None:
        self.ask(page, self._desk.table.lead_hand, pose, is_held)

    # -- what is shown ------------------------------------------------------------------------------------------------

    def show(self, view: DeskView) -> None:
        """Show a view, soon; to be called up to thirty times per second."""
        self._views.give(view)

    def _show(self, view: DeskView) -> None:
        now = time.monotonic()
        with self._server.atomic():
            graph = view.graph
            if graph.joints is not None:
                self._robot.show(graph.joints)
            self._frames.show(graph.frames, view.places)
            self._hand.show(graph.hand, view.aim)
            self._model.show(graph.reference, graph.components, graph.horizon if view.run.goes_on else None)
            self._suggested.show({} if view.suggested is None else view.suggested.frames)
            self._stiffness.show(graph.hand, graph.stiffness)
            self._show_preview(view, now)
        if now >= self._text_due:
            self._text_due = now + TEXT_PERIOD
            self._show_texts(view)

    def _show_texts(self, view: DeskView) -> None:
        self._hand.draw_trail()
        self._stop.show(view)
        several = self.driver.pages > 1
        for page, told in list(self._told.items()):
            self._tell(page, told)
        if self._take_over.visible != several:
            self._take_over.visible = several
        for panel in self._panels:
            panel.show(view)

    def _show_preview(self, view: DeskView, now: float) -> None:
        """The tube of a movement, and the robot's ghost that goes through it again and again."""
        if view.preview is not self._shown:
            self._shown, self._shown_since = view.preview, now
            if view.preview is None:
                self._model.preview.show(None, None)
            else:
                self._model.preview.show(view.preview.path[:, :3], view.preview.covariances[:, :3, :3])
        # where the movement is shown as it is now, as it was foreseen would only hide that
        self._model.preview.visible = self._shown is not None and not self._model.has_horizon
        moves = self._shown is not None and not view.run.goes_on
        if self._ghost is None and moves:
            self._ghost = RobotDisplay(
                self._server.scene, self._desk.robot, self._moving_parts(), "/ghost", PREVIEW, opacity=0.3
            )
        if self._ghost is not None:
            self._ghost.visible = moves
            if moves and self._shown is not None:
                share = ((now - self._shown_since) / GHOST_TIME) % 1.0
                self._ghost.show(self._shown.q[round(share * (len(self._shown.q) - 1))])

    def _moving_parts(self) -> Shapes:
        """Those of the arm that the movement is of."""
        robot = self._desk.robot
        joints = set(robot.joint_groups[robot.endpoints[self._desk.project.task.endpoint].joints])
        known = [part for part in self._shapes.parts if robot.pinocchio.existFrame(part.link)]
        return Shapes(tuple(part for part in known if joints.intersection(robot.joints_above(part.link))), ())

    def close(self) -> None:
        """Serve no more."""
        self._server.stop()

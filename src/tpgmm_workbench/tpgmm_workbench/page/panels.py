# SPDX-License-Identifier: Apache-2.0
"""The panels of the page: teach, train, run, torques, and what the nodes say. They show a view and ask for things."""

from __future__ import annotations

from functools import partial
from typing import Any

from viser import GuiEvent, ViserServer

from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page import robot_words, words
from tpgmm_workbench.page.controls import Ask, Button, Slider, Text
from tpgmm_workbench.page.notes_panel import NotesPanel
from tpgmm_workbench.project.activities import Action, Activity
from tpgmm_workbench.scene.heard import in_order


class TeachPanel:
    """Record demonstrations; in a simulation, also lead the hand and move the objects."""

    def __init__(self, server: ViserServer, desk: Desk, ask: Ask) -> None:
        self._is_recording = False
        self._desk, self._ask = desk, ask
        self._record = Button(server, "Record", self._begin_or_end, "R", color="red")
        self._length = Text(server)
        self._hide: dict[str, Any] = {}
        self._led: Text | None = None
        self._leads: list[Any] = []
        if desk.simulated:
            self._lead(server)
            self._objects(server)
        self._undo = Button(server, "Undo the last one", lambda page: ask(page, desk.undo), "U")
        self._redo = Button(server, "Bring it back", lambda page: ask(page, desk.redo), "Y")
        Button(server, "Where next?", lambda page: ask(page, desk.teaching.suggest))
        self._next = Text(server)
        self._lay = None
        if desk.simulated:
            self._lay = Button(server, "Lay the objects there", lambda page: ask(page, desk.lay_as_suggested))
        self._list = Text(server)
        self._notes = NotesPanel(server, desk, ask)

    def _begin_or_end(self, page: int | None) -> None:
        self._ask(page, self._desk.end_recording if self._is_recording else self._desk.record)

    def _lead(self, server: ViserServer) -> None:
        desk, ask = self._desk, self._ask
        with server.gui.add_folder("Lead the hand (or drag its gizmo)"):
            self._led = Text(server)
            for name in desk.project.task.topics:
                group = server.gui.add_button_group(name, (f"above {name}", f"to {name}"))
                group.on_click(in_order(partial(self._lead_to, name)))
                self._leads.append(group)
            group = server.gui.add_button_group("hand", ("home", "let go"))
            group.on_click(
                in_order(
                    lambda event: (
                        ask(event.client_id, desk.table.let_go)
                        if event.target.value == "let go"
                        else ask(event.client_id, desk.table.lead_to, "home", False)
                    )
                )
            )
            self._leads.append(group)

    def _objects(self, server: ViserServer) -> None:
        desk, ask = self._desk, self._ask
        with server.gui.add_folder("Objects (or drag their gizmos)"):
            Button(server, "Lay them elsewhere", lambda page: ask(page, desk.table.shuffle), "N")
            for name in desk.project.task.topics:
                box = server.gui.add_checkbox(f"hide {name}", False)
                box.on_update(in_order(partial(self._hide_or_show, name)))
                self._hide[name] = box

    def _lead_to(self, name: str, event: GuiEvent[Any]) -> None:
        self._ask(event.client_id, self._desk.table.lead_to, name, event.target.value.startswith("above "))

    def _hide_or_show(self, name: str, event: GuiEvent[Any]) -> None:
        if event.client_id is not None:  # none: this program has set the box
            self._ask(event.client_id, self._desk.table.hide_object, name, bool(event.target.value))

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._is_recording = view.activity is Activity.TEACHING
        action = Action.END_RECORDING if self._is_recording else Action.RECORD
        self._record.show(view.reasons.get(action, ""), "Finish" if self._is_recording else "Record")
        self._undo.show(view.reasons.get(Action.UNDO, ""))
        self._redo.show(view.reasons.get(Action.REDO, ""), is_there=not view.reasons.get(Action.REDO))
        self._length.show(words.recording(view))
        self._next.show(words.suggestion(view))
        if self._lay is not None:
            self._lay.show("" if view.suggested is not None else "press “Where next?” first")
        self._list.show(words.demonstrations(view))
        self._notes.show(view)
        if self._led is not None:
            self._led.show(words.led(view))
        may_lead = not view.reasons.get(Action.DRAG_HAND)
        for group in self._leads:
            if group.visible != may_lead:  # a group of buttons cannot be disabled (viser 1.1); the reason stands above
                group.visible = may_lead
        for name, box in self._hide.items():
            if box.value != (name in view.hidden):
                box.value = name in view.hidden


class TrainPanel:
    """Learn from what was taught."""

    def __init__(self, server: ViserServer, desk: Desk, ask: Ask) -> None:
        self._choose = server.gui.add_checkbox(
            "choose method and settings", False, hint="Tries several and keeps the best; takes longer"
        )
        self._train = Button(
            server, "Train", lambda page: ask(page, desk.train, bool(self._choose.value)), "T", color="blue"
        )
        self._cancel = Button(server, "Cancel training", lambda page: ask(page, desk.cancel_training))
        self._bar: Any = server.gui.add_progress_bar(0.0, visible=False)
        self._words, self._model, self._relevance = Text(server), Text(server), Text(server)

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._train.show(view.reasons.get(Action.TRAIN, ""))
        self._cancel.show(view.reasons.get(Action.CANCEL_TRAINING, ""))
        progress = view.progress
        goes_on = progress is not None and not progress.is_over
        if self._bar.visible != goes_on:
            self._bar.visible = goes_on
        if progress is not None and goes_on and abs(self._bar.value - 100.0 * progress.share) > 0.5:
            self._bar.value = min(100.0, max(0.0, 100.0 * progress.share))
        self._words.show(words.training(view))
        self._model.show(words.model(view))
        self._relevance.show(words.relevance(view))


class RunPanel:
    """Look ahead, and run."""

    def __init__(self, server: ViserServer, desk: Desk, ask: Ask) -> None:
        self._ask, self._desk = ask, desk
        self._duration = Slider(
            server, "duration, s", lambda page, value: ask(page, desk.set_duration, value),
            (0.0, 40.0), 1.0, 0.0, hint="Of the movement; 0: as taught",
        )  # fmt: skip
        self._preview = Button(server, "Preview", lambda page: ask(page, desk.preview), "P")
        self._verdict = Text(server)
        self._advised = 0
        self._take = Button(server, "Use the advised duration", self._take_advised, visible=False)
        self._run = Button(server, "Run", lambda page: ask(page, desk.run), "G", color="green")
        self._pause = Button(server, "Pause", lambda page: ask(page, desk.pause), "space")
        self._speed = Slider(
            server, "speed", lambda page, value: ask(page, desk.set_speed, value),
            (-1.0, 2.0), 0.1, 1.0, hint="1: as taught; below 0: back",
        )  # fmt: skip
        self._bar: Any = server.gui.add_progress_bar(0.0)
        self._state, self._novelty = Text(server), Text(server)
        self._is_coaching = False
        self._coach = Button(
            server,
            "Coach",
            lambda page: ask(page, desk.end_coaching if self._is_coaching else desk.coach),
            "C",
            color="orange",
        )
        self._coached, self._force = Text(server), Text(server)

    def _take_advised(self, page: int | None) -> None:
        self._ask(page, self._desk.set_duration, float(self._advised))
        self._ask(page, self._desk.preview)

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._is_coaching = view.activity is Activity.COACHING
        action = Action.END_COACHING if self._is_coaching else Action.COACH
        self._coach.show(view.reasons.get(action, ""), "Let go" if self._is_coaching else "Coach")
        self._coached.show(words.coaching(view))
        self._force.show(robot_words.force(view))
        self._preview.show(view.reasons.get(Action.PREVIEW, ""))
        is_paused = view.activity is Activity.PAUSED
        self._run.show(view.reasons.get(Action.RUN, ""), "Go on" if is_paused else "Run")
        self._pause.show(view.reasons.get(Action.PAUSE, ""))
        self._verdict.show(words.verdict(view))
        self._advised = (view.preview.advised if view.preview is not None else None) or 0
        self._take.show(label=f"Use {self._advised} s" if self._advised else None, is_there=bool(self._advised))
        self._duration.show(view.duration)
        self._speed.show(view.speed)
        self._state.show(words.run(view))
        self._novelty.show(words.novelty(view))
        share = round(100.0 * min(1.0, max(0.0, view.run.phase)))
        if self._bar.value != share:
            self._bar.value = share


class RobotPanel:
    """How stiff the hand is held, and the torques that are sent."""

    def __init__(self, server: ViserServer) -> None:
        self._stiffness, self._torques = Text(server), Text(server)

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._stiffness.show(robot_words.stiffness(view))
        self._torques.show(robot_words.torques(view))


class NodesPanel:
    """What the nodes say of themselves."""

    def __init__(self, server: ViserServer) -> None:
        self._text = Text(server)

    def show(self, view: DeskView) -> None:
        """Show what is known."""
        self._text.show(robot_words.nodes(view))

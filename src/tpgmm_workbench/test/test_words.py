# SPDX-License-Identifier: Apache-2.0
"""What the panels say, and which page drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core.retrieval.relevance import Relevance
from tpgmm_workbench.desk.learning import ModelView
from tpgmm_workbench.desk.teaching import TaughtView
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.page import robot_words, words
from tpgmm_workbench.page.added import MARK
from tpgmm_workbench.page.driver import Driver
from tpgmm_workbench.page.html import chip
from tpgmm_workbench.page.names import names_alone
from tpgmm_workbench.project.activities import Action, Activity, Facts, may
from tpgmm_workbench.project.preview import Check, Preview
from tpgmm_workbench.project.suggestion import Suggestion
from tpgmm_workbench.project.training import Progress
from tpgmm_workbench.scene.colors import FRAME, GREEN, GREY, RED, SEVERAL, SKY, YELLOW, contrast, css, readable_on
from tpgmm_workbench.session.view import ControllerView, FrameView, GraphView, NodeView, StiffnessView, TorqueView

READY = DeskView(graph=GraphView(joints=np.zeros(2), controller=ControllerView("DAMPING", "no reference yet")))


def taught(count: int) -> tuple[TaughtView, ...]:
    return tuple(TaughtView(i + 1, True, "good", "12 s") for i in range(count))


def test_a_newcomer_is_told_what_to_do_next_at_each_step() -> None:
    model = ModelView(1, "1.tpgmm", ("reproduces what it has not seen to 4 mm",), {})
    steps = [
        READY,
        replace(READY, activity=Activity.TEACHING),
        replace(READY, activity=Activity.TEACHING, lasted=2.0),
        replace(READY, taught=taught(3)),
        replace(READY, taught=taught(4)),
        replace(READY, taught=taught(4), progress=Progress(0.2, "learning")),
        replace(READY, taught=taught(4), model=model),
        replace(READY, taught=taught(4), model=model, activity=Activity.RUNNING),
    ]
    said = [words.next_step(step) for step in steps]
    assert len(set(said)) == len(said)
    for text, word in zip(
        said,
        ["4 more times", "released", "Finish", "1 more time.", "Train", "learned", "Preview", "Move an object"],
        strict=True,
    ):
        assert word in text
    assert "no joint states" in words.next_step(
        replace(READY, reasons={Action.RECORD: may("record", Facts(has_robot=False))})
    )


def test_what_others_wrote_is_text_and_never_a_part_of_the_page() -> None:
    evil = '<img src=x onerror="alert(1)">'
    graph = GraphView(
        frames=(FrameView(evil, "refused", 0.1, why=evil),),
        controller=ControllerView(evil, evil),
        torques=(TorqueView(evil, 1.0, 2.0, evil),),
        nodes={evil: NodeView(False, evil, {"tick_rate_hz": "10"})},
    )
    view = DeskView(
        graph=graph,
        run=RunView("failed", 0.5, evil),
        taught=(TaughtView(1, True, "look", evil),),
        model=ModelView(1, evil, (evil,), {1: evil}, Relevance("movement", {evil: np.ones(4)})),
        suggested=Suggestion({evil: np.zeros(7)}, 1.0, evil),
        coached=evil,
        shared=evil,
        progress=Progress(0.1, evil),
        words=(evil,),
        preview=Preview(
            np.zeros(1), np.zeros((1, 7)), np.zeros((1, 6, 6)), np.zeros((1, 2)), (Check(evil, None, evil),)
        ),
    )
    panels = (words.status, words.demonstrations, words.model, words.training, words.verdict, words.run)
    later = (words.suggestion, words.relevance, words.coaching, words.sharing)
    for say in (*panels, *later, robot_words.torques, robot_words.nodes):
        assert "<img" not in say(view), say.__name__


def test_a_movement_that_is_paused_is_not_called_running_also_while_it_is_corrected() -> None:
    view = DeskView(run=RunView("running", 0.4), activity=Activity.COACHING)
    assert "running" in words.run(view) and "paused" not in words.run(view)
    assert "paused" in words.run(replace(view, is_paused=True))
    assert "paused" not in words.run(replace(view, run=RunView("done", 1.0), is_paused=True))


def test_it_is_told_where_in_a_movement_each_frame_counts() -> None:
    shares = {"object": np.array([0.9, 0.8, 0.6, 0.2]), "target": np.array([0.1, 0.2, 0.4, 0.8]), "robot": np.zeros(4)}
    view = replace(READY, model=ModelView(1, "1.tpgmm", (), {}, Relevance("movement", shares)))
    text = words.relevance(view)
    for name, said in (("object", "most in 75%"), ("target", "most in 25%"), ("robot", "never counts most")):
        assert said in text.partition(f">{name}<")[2].partition("<div")[0]
    assert text.count("flex:0.900") == 1 and not words.relevance(READY)


def test_each_state_has_its_word_beside_its_colour() -> None:
    frames = tuple(FrameView(name, name) for name in ("seen", "held", "missing", "refused", "fixed"))
    text = words.status(replace(READY, graph=replace(READY.graph, frames=frames)))
    assert all(f"{name}: {name}" in text for name in ("seen", "held", "missing", "refused", "fixed"))
    assert "DAMPING" in text and "no reference yet" in text
    assert "no controller" in words.status(DeskView())


def test_a_frame_that_is_not_seen_any_more_says_since_when() -> None:
    frames = (
        FrameView("cup", "held", 1.25),
        FrameView("plate", "missing", 90.0),
        FrameView("jug", "refused", 0.1, why="x"),
    )
    text = words.status(replace(READY, graph=replace(READY.graph, frames=frames)))
    assert "cup: held, seen 1.2 s ago<" in text and "plate: missing for " in text and "jug: refused<" in text


def test_torques_are_told_against_their_limits_and_what_is_near_one_says_so() -> None:
    graph = GraphView(
        torques=(
            TorqueView("s0", 10.0, 50.0),
            TorqueView("s1", -40.0, 50.0),
            TorqueView("lift", 60.0, 60.0, "N"),
            TorqueView("w2", -0.01, 15.0),
        ),
        stiffness=StiffnessView(np.diag([500.0, 100.0, 300.0, 20.0, 5.0, 10.0])),
    )
    rows = robot_words.torques(DeskView(graph=graph)).split("</div></div>")
    assert "s0: 10.0 of 50 N m" in rows[0] and "width:20%" in rows[0] and "near" not in rows[0]
    assert "s1: -40.0 of 50 N m" in rows[1] and "width:80%" in rows[1] and "near" in rows[1]
    assert "lift: 60.0 of 60 N " in rows[2] and "width:100%" in rows[2] and "at its limit" in rows[2]
    assert "w2: 0.0 of 15 N m" in rows[3]
    assert "100 to 500 N/m, turning 5.0 to 20.0 N m/rad" in robot_words.stiffness(DeskView(graph=graph))
    assert "No torques" in robot_words.torques(DeskView()) and "nothing is tracked" in robot_words.stiffness(DeskView())


def test_each_word_on_a_coloured_ground_can_be_read() -> None:
    for ground in (*SEVERAL, *FRAME.values(), GREEN, GREY, RED, SKY, YELLOW):
        text = readable_on(ground)
        assert contrast(text, ground) >= 4.5
        assert f"background:{css(ground)};color:{css(text)}" in chip("word", ground)
    assert contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21.0)


def test_each_page_is_told_whether_it_drives_and_the_server_hears_it() -> None:
    assert MARK in words.pages(1, 4, 4) and "drives" not in words.pages(1, 4, 4)
    assert "10 pages show this; this one drives" in words.pages(10, 4, 4)
    assert "another one drives" in words.pages(10, 4, 5)
    assert "the first page that requests" in words.pages(2, None, 5)
    assert "token" in words.pages(1, 4, 4, is_open=True)


def test_of_several_pages_one_drives_and_another_may_take_over() -> None:
    driver = Driver()
    for page in (1, 2, 3):
        driver.come(page)
    assert driver.drives(1) and not driver.drives(2)
    driver.take_over(2)
    assert driver.drives(2) and not driver.drives(1)
    assert driver.go(2) and driver.number is None
    assert not driver.go(1) and driver.pages == 1
    assert driver.drives(3) and driver.number == 3
    assert driver.go(3)
    driver.come(4)
    assert driver.number == 4


def test_a_page_shows_names_of_files_and_not_where_on_this_machine_they_lie(tmp_path: Path) -> None:
    said = [
        (f"{tmp_path / 'cups'} is not a project: it lacks task.yaml", "cups is not a project: it lacks task.yaml"),
        (f"[Errno 2] No such file: '{tmp_path}/a/b.mcap'; try again", "[Errno 2] No such file: 'b.mcap'; try again"),
        (f"<div>imported into {Path.home()}/cups</div>", "<div>imported into cups</div>"),
        (f"read {Path.cwd()}/out/1.tpgmm, /tmp/x.zip", "read 1.tpgmm, x.zip"),
    ]
    for text, shown in said:
        assert names_alone(text) == shown
    for text in (
        "<div>5 of 50 N m/rad</div>",
        "nothing on /endpoint/left/pose: see http://127.0.0.1:8080/home/x",
        "package://example-robot-data/usr/x.urdf, out/workbench/home/x",
        "/ is no file",
    ):
        assert names_alone(text) == text

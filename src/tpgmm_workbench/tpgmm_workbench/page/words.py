# SPDX-License-Identifier: Apache-2.0
"""What panels say, as HTML: pure functions of a view. Each colour has a word beside it."""

from __future__ import annotations

from html import escape
from itertools import cycle

from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page.added import MARK
from tpgmm_workbench.page.html import block, chip
from tpgmm_workbench.project.activities import LEAST, Action, Activity
from tpgmm_workbench.scene.colors import FRAME, GREEN, GREY, RED, SEVERAL, SKY, YELLOW, Color, css

#: So many demonstrations before training is suggested: with fewer, hardly anything is known of how exact a skill is.
SUGGESTED = 4
#: A hand that is led is there when it is so near, m.
THERE = 0.012
_CONTROLLER = {"WAITING": GREY, "ACTIVE": GREEN, "HOLD": YELLOW, "DAMPING": SKY, "FAULT": RED}
#: Of the words below STOP; more of them are scrolled.
STATUS_HEIGHT = "11em"
_LEVELS: dict[str, tuple[Color, str]] = {
    "good": (GREEN, "good"),
    "look": (YELLOW, "look"),
    "bad": (RED, "bad"),
    "": (GREY, "…"),
}


def next_step(view: DeskView) -> str:
    """What a newcomer does next, in words."""
    reasons = view.reasons
    if view.activity is Activity.TEACHING:
        if view.lasted == 0.0:
            return "The arm is being released: the recording begins in a moment."
        return "Show the movement: lead the hand. Then press Finish."
    if view.activity is Activity.COACHING:
        led = "Drag the hand's gizmo" if view.places else "Lead the hand"
        return f"{led} to where the hand should be. Then press Let go."
    if view.activity in (Activity.RUNNING, Activity.PAUSED):
        return "Move an object, or hide it, and see how the movement adapts."
    if view.progress is not None and not view.progress.is_over:
        return "The skill is being learned. You may go on teaching meanwhile."
    if view.model is not None and view.preview is None:
        return "Press Preview: see where the skill would go. Then press Run."
    if view.model is not None:
        return "Press Run. Move the objects and run it again, or teach one more demonstration."
    if len(view.taught) >= SUGGESTED and not reasons.get(Action.TRAIN):
        return "Press Train, or show it once more: the more situations, the better."
    if reasons.get(Action.RECORD):
        return f"Before you teach: {reasons[Action.RECORD]}"
    more = max(LEAST, SUGGESTED) - len(view.taught)
    begin = (
        "Lay the objects elsewhere, lead the hand to where it begins"
        if view.taught
        else "Lead the hand to where it begins"
    )
    return f"{begin}, and press Record. Show the movement {more} more time{'s' if more != 1 else ''}."


def status(view: DeskView) -> str:
    """Controller, activity, what to do next, and what was said; always as high, so that nothing beside it moves."""
    controller = view.graph.controller
    if controller is None:
        first = chip("no controller", GREY) + " no controller_state arrives; check that impedance_controller is running"
    else:
        first = chip(controller.state, _CONTROLLER.get(controller.state, GREY)) + " " + escape(controller.reason)
    robot = "" if view.graph.joints is not None else chip("no robot", RED) + " no joint states arrive"
    frames = " ".join(
        # why one is refused is too long here, and stands among what the nodes say
        chip(f"{frame.name}: {frame.state if frame.why else frame.words}", FRAME[frame.state])
        for frame in view.graph.frames
    )
    lines = [first, robot, frames, f"<b>{escape(next_step(view))}</b>"]
    lines += [f"<i>{escape(words)}</i>" for words in view.words]
    return block([line for line in lines if line], f"height:{STATUS_HEIGHT};overflow-y:auto")


def led(view: DeskView) -> str:
    """How far the hand still is from where it is led."""
    if view.aim is None:
        reason = view.reasons.get(Action.DRAG_HAND, "")
        return block(["Nobody leads the hand.", escape(reason)] if reason else ["Nobody leads the hand."])
    if view.to_go is None:
        return block(["The hand is led; no pose of it arrives."])
    return block(["The hand is there." if view.to_go < THERE else f"{100.0 * view.to_go:.0f} cm to go."])


def recording(view: DeskView) -> str:
    """How long the present recording is."""
    if view.activity is not Activity.TEACHING:
        return ""
    return block([chip("recording", RED) + f" {view.lasted:.0f} s"])


def suggestion(view: DeskView) -> str:
    """Where to show it next, and why there."""
    if view.suggested is None:
        return ""
    places = "; ".join(
        f"{escape(name)} at " + ", ".join(f"{value:.2f}" for value in pose[:3]) + " m"
        for name, pose in view.suggested.frames.items()
    )
    return block([f"{chip('next', GREEN)} {places}", escape(view.suggested.words)])


def demonstrations(view: DeskView) -> str:
    """The demonstrations, newest first, each with its verdict."""
    if not view.taught:
        return block(["No demonstration yet."])
    lines = []
    for one in reversed(view.taught):
        color, word = _LEVELS.get(one.level, (GREY, one.level))
        fits = view.model.misfits.get(one.number, "") if view.model is not None else ""
        words = "; ".join(part for part in (one.words, fits) if part)
        used = "" if one.is_used else " (left out)"
        kind = f" corrects model {one.corrects};" if one.corrects else ""
        comment = f" <i>{escape(one.comment)}</i>;" if one.comment else ""
        lines.append(f"<b>{one.number}</b>{used} {chip(word, color)}{kind}{comment} {escape(words)}")
    return block(lines)


def coaching(view: DeskView) -> str:
    """What goes on of a correction, or came of the last one."""
    if not view.coached:
        return ""
    mark = chip("coaching", RED) + " " if view.activity is Activity.COACHING else ""
    return block([mark + escape(view.coached)])


def sharing(view: DeskView) -> str:
    """What came of the last export or import; before, what they are."""
    if view.shared:
        return block([escape(view.shared)])
    return block(
        [
            "One file with bags, task file, robot file, models and a report.",
            "An imported project is checked, and gets a folder of its own.",
        ]
    )


def picture(view: DeskView) -> str:
    """What came of the last picture."""
    return block([escape(view.pictured)]) if view.pictured else ""


def model(view: DeskView) -> str:
    """How well the present model does."""
    if view.model is None:
        return block(["No model yet."])
    return block([f"<b>Model {view.model.number}</b>", *(escape(words) for words in view.model.words)])


def relevance(view: DeskView) -> str:
    """How much each frame says over the movement: a column for each part of it, and in words where each says most."""
    found = None if view.model is None else view.model.relevance
    if found is None or not found.shares:
        return ""
    colors = dict(zip(found.shares, cycle(SEVERAL), strict=False))
    parts = list(zip(*found.shares.values(), strict=True))
    names = list(found.shares)
    columns = "".join(
        '<div style="flex:1;display:flex;flex-direction:column">'
        + "".join(
            f'<div style="flex:{share:.3f} 0 0;background:{css(colors[name])}"></div>'
            for name, share in zip(names, part, strict=True)
        )
        + "</div>"
        for part in parts
    )
    most = [names[max(range(len(names)), key=part.__getitem__)] for part in parts]
    lines = [
        f"<b>How much each frame counts</b>, {'from begin to end' if found.along == 'movement' else 'by component'}",
        f'<div style="display:flex;height:3.5em">{columns}</div>',
    ]
    for name in names:
        where = [number for number, first in enumerate(most) if first == name]
        text = f"counts most in {len(where) / len(most):.0%} of it" if where else "never counts most"
        lines.append(f"{chip(name, colors[name])} {text}")
    return block(lines)


def training(view: DeskView) -> str:
    """How far a training is, or why there is none."""
    if view.progress is not None and not view.progress.is_over:
        return block([escape(view.progress.words)])
    reason = view.reasons.get(Action.TRAIN, "")
    return block([escape(reason)]) if reason else ""


def verdict(view: DeskView) -> str:
    """What the preview says before anything moves."""
    if view.preview is None:
        return block([escape(view.reasons.get(Action.PREVIEW, "")) or "Not previewed yet."])
    words = {True: chip("yes", GREEN), False: chip("no", RED), None: chip("not known", GREY)}
    first = chip("may run", GREEN) if view.preview.may_run else chip("does not run like this", RED)
    lines = [f"{words[check.is_good]} {escape(check.name)}: {escape(check.words)}" for check in view.preview.checks]
    return block([first, *lines])


def run(view: DeskView) -> str:
    """How far the movement is, and how it ended."""
    colors = {"running": SKY, "asked": GREY, "done": GREEN, "failed": RED, "stopped": YELLOW}
    if view.run.stage == "idle":
        return block([escape(view.reasons.get(Action.RUN, ""))]) if view.reasons.get(Action.RUN) else ""
    stage = "paused" if view.is_paused and view.run.goes_on else view.run.stage
    share = f" {100.0 * view.run.phase:.0f} %" if view.run.goes_on else ""
    lines = [f"{chip(stage, colors.get(view.run.stage, GREY))}{share} {escape(view.run.words)}", escape(view.waits)]
    return block([line for line in lines if line])


def novelty(view: DeskView) -> str:
    """How new the situation is while the skill runs, beside its limit."""
    if view.novelty is None:
        return ""
    found = view.novelty
    if found.score is None:
        return block([f"<b>Novelty</b> now: {escape(found.words)}"])
    over = chip("too new", RED) + " " if found.score > found.limit else ""
    return block([f"<b>Novelty</b> now: {found.score:.1f}, at most {found.limit:.0f} {over}({escape(found.words)})"])


def pages(count: int, driver: int | None, page: int, is_open: bool = False) -> str:
    """What one page is told of the others: which one drives, and whether other machines may open more.

    It is told nothing before the server hears it: that is what its mark stands for.

    Parameters
    ----------
    count
        of pages that are open
    driver
        number of the one that drives; None where nobody does
    page
        number of the one that is told
    is_open
        whether other machines may open pages

    Returns
    -------
    str
        HTML
    """
    lines = []
    if is_open:
        lines.append(chip("open to other machines", YELLOW) + " anyone with the token can move the robot")
    if count > 1:
        drives = {None: "the first page that requests something takes control", page: "this one drives"}
        lines.append(f"{count} pages show this; {drives.get(driver, 'another one drives')}.")
    return f'<span id="{MARK}"></span>' + (block(lines) if lines else "")

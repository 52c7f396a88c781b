# SPDX-License-Identifier: Apache-2.0
"""What may be done now, and if not, why: a table of rules over what is going on and what is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from tpgmm_core.common.text import listed

LEAST = 2
"""Demonstrations that a model needs: one does not tell how a movement follows its frames."""


class Activity(Enum):
    """What a workbench is doing. Training goes on beside all of them, and is told of in `Facts`."""

    IDLE = "nothing"
    TEACHING = "a demonstration is being recorded"
    RUNNING = "the skill runs"
    PAUSED = "the skill is paused"
    COACHING = "the skill is being corrected"


class Action(Enum):
    """What a user may ask for."""

    RECORD = "record"
    END_RECORDING = "end_recording"
    UNDO = "undo"
    REDO = "redo"
    TRAIN = "train"
    CANCEL_TRAINING = "cancel_training"
    PREVIEW = "preview"
    RUN = "run"
    PAUSE = "pause"
    COACH = "coach"
    END_COACHING = "end_coaching"
    STOP = "stop"
    EXPORT = "export"
    IMPORT = "import"
    DRAG_HAND = "drag_hand"


@dataclass(frozen=True, slots=True)
class Facts:
    """What the rules ask about.

    Parameters
    ----------
    activity
        what is going on
    demonstrations
        number of those that are used
    has_model
        whether there is a model that was not undone
    is_training
        whether a training runs in the background
    can_undo
        whether there is something to undo
    can_redo
        whether something was undone
    is_read
        whether the folder of the project has been read: what it holds is not known before
    has_robot
        whether the robot's state arrives
    missing_frames
        observed frames of the task that are not seen at the moment
    is_simulated
        whether the robot is the simulator
    fault
        the controller's reason where it is in a fault; else empty
    drives
        whether this page is the one that drives
    """

    activity: Activity = Activity.IDLE
    demonstrations: int = 0
    has_model: bool = False
    is_training: bool = False
    can_undo: bool = False
    can_redo: bool = False
    is_read: bool = True
    has_robot: bool = True
    missing_frames: tuple[str, ...] = ()
    is_simulated: bool = True
    fault: str = ""
    drives: bool = True


type _Rule = Callable[[Facts], str]
"""The reason why something may not be done; empty where nothing speaks against it."""


def _drives(facts: Facts) -> str:
    return "" if facts.drives else "another page drives: take over first, or only watch"


def _idle(facts: Facts) -> str:
    return "" if facts.activity is Activity.IDLE else f"{facts.activity.value}: end that first"


def _read(facts: Facts) -> str:
    return "" if facts.is_read else "the project is still being read: ask again in a moment"


def _robot(facts: Facts) -> str:
    return "" if facts.has_robot else "no joint states arrive; check that the robot or the simulator is running"


def _frames(facts: Facts) -> str:
    missing = facts.missing_frames
    return f"not seen: {listed(missing)}; bring it into view, or place it by hand" if missing else ""


def _no_fault(facts: Facts) -> str:
    return f"the controller is in a fault ({facts.fault}): fix this first" if facts.fault else ""


def _model(facts: Facts) -> str:
    return "" if facts.has_model else "there is no model yet: train one first"


def _enough(facts: Facts) -> str:
    more = LEAST - facts.demonstrations
    if more <= 0:
        return ""
    what = "demonstration" if more == 1 else "demonstrations"
    return (
        f"{facts.demonstrations} used, and {LEAST} are the least: show {more} more {what}, with the objects elsewhere"
    )


def _no_training(facts: Facts) -> str:
    return "a training is going on: wait for its end, or cancel it" if facts.is_training else ""


def _during(*activities: Activity) -> _Rule:
    what = " or ".join(activity.value for activity in activities)

    def rule(facts: Facts) -> str:
        return "" if facts.activity in activities else f"only while {what}"

    return rule


RULES: dict[Action, tuple[_Rule, ...]] = {
    Action.RECORD: (_drives, _idle, _robot, _frames, _no_fault),
    Action.END_RECORDING: (_drives, _during(Activity.TEACHING)),
    Action.UNDO: (_drives, _idle, _read, lambda f: "" if f.can_undo else "there is nothing to undo"),
    Action.REDO: (_drives, _idle, _read, lambda f: "" if f.can_redo else "nothing was undone"),
    Action.TRAIN: (_drives, _read, _enough, _no_training),
    Action.CANCEL_TRAINING: (_drives, lambda f: "" if f.is_training else "no training is going on"),
    Action.PREVIEW: (_read, _model, _robot, _frames),
    Action.RUN: (
        _drives,
        lambda f: "" if f.activity is Activity.PAUSED else _idle(f),
        _read,
        _model,
        _robot,
        _frames,
        _no_fault,
    ),
    Action.PAUSE: (_drives, _during(Activity.RUNNING)),
    Action.COACH: (_drives, _during(Activity.RUNNING, Activity.PAUSED)),
    Action.END_COACHING: (_drives, _during(Activity.COACHING)),
    Action.STOP: (),  # always, from every page
    Action.EXPORT: (lambda f: f"{f.activity.value}: end it first" if f.activity is Activity.TEACHING else "",),
    Action.IMPORT: (_drives, _idle, _no_training),
    Action.DRAG_HAND: (
        _drives,
        lambda f: "" if f.is_simulated else "only the simulated hand can be dragged: lead the real arm by hand",
        _robot,
    ),
}
"""Action -> what is asked in turn; the first reason counts."""


def may(action: Action | str, facts: Facts) -> str:
    """Say why something may not be done now.

    Parameters
    ----------
    action
        what is asked for
    facts
        what is going on

    Returns
    -------
    str
        the reason in words; empty where it may be done
    """
    for rule in RULES[Action(action)]:
        reason = rule(facts)
        if reason:
            return reason
    return ""

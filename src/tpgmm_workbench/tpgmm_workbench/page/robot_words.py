# SPDX-License-Identifier: Apache-2.0
"""What panels say of the robot and of the nodes, as HTML: pure functions of a view."""

from __future__ import annotations

from html import escape

from tpgmm_core.observation.touch import FREE
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.page.html import block, chip
from tpgmm_workbench.project.activities import Activity
from tpgmm_workbench.scene.colors import GREEN, RED, YELLOW, css

#: Shares of a torque limit from which on a joint is near it, and at it.
NEAR_LIMIT, AT_LIMIT = 0.7, 0.98


def force(view: DeskView) -> str:
    """How hard somebody pushes the hand, and what comes of it; nothing where that is not asked for."""
    known = view.graph.force
    if known is None or view.coach_force <= 0.0:
        return ""
    title = "<b>Force on the hand</b>: "
    if known.newtons is None:
        return block([f"{title}cannot be known: {escape(known.why)}. Use the button Coach."])
    words = f"{title}{known.newtons:.0f} N, by {escape(known.source)}"
    if view.activity in (Activity.RUNNING, Activity.PAUSED) and not view.may_grab:
        return block([f"{words}. It has to be below {FREE * view.coach_force:.0f} N before the hand is held."])
    return block([f"{words}. While the skill runs, {view.coach_force:.0f} N begin a correction."])


def torques(view: DeskView) -> str:
    """The torque of each joint against its limit: a bar, a word, and numbers."""
    if not view.graph.torques:
        return block(["No torques are sent now."])
    lines = ["<b>Torques</b>, and their limits"]
    for one in view.graph.torques:
        color, word = GREEN, ""
        if one.share >= NEAR_LIMIT:
            color, where = (RED, "at its limit") if one.share >= AT_LIMIT else (YELLOW, "near its limit")
            word = chip(where, color)
        lines.append(
            f"{escape(one.joint)}: {one.torque:z.1f} of {one.limit:.0f} {escape(one.unit)} {word}"
            f'<div style="background:rgba(130,130,130,0.3);height:0.4em;border-radius:0.2em">'
            f'<div style="background:{css(color)};height:100%;border-radius:0.2em;'
            f'width:{100.0 * min(1.0, one.share):.0f}%"></div></div>'
        )
    return block(lines)


def stiffness(view: DeskView) -> str:
    """How stiff the hand is held, from its softest direction to its stiffest one."""
    known = view.graph.stiffness
    if known is None:
        return block(["<b>Stiffness</b> of the hand: none, nothing is tracked now"])
    along, about = known.along[0], known.about[0]
    return block(
        [
            f"<b>Stiffness</b> of the hand: {along[0]:.0f} to {along[2]:.0f} N/m, "
            f"turning {about[0]:.1f} to {about[2]:.1f} N m/rad",
            "The ellipsoid at the hand is long where it is stiff.",
        ]
    )


def nodes(view: DeskView) -> str:
    """What each node says, its rate and its times of steps; when each frame was seen."""
    lines = [
        f"{chip('well' if node.well else 'look', GREEN if node.well else YELLOW)} <b>{escape(name)}</b> "
        f"{escape(node.figures)}<br>{escape(node.words)}"
        for name, node in sorted(view.graph.nodes.items())
    ]
    lines += [f"frame <b>{escape(frame.name)}</b>: {escape(frame.words)}" for frame in view.graph.frames]
    return block(lines or ["No diagnostics received."])

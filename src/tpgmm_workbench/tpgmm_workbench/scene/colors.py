# SPDX-License-Identifier: Apache-2.0
"""Colours that people with any kind of colour vision tell apart (Okabe and Ito 2008), and what each stands for."""

from __future__ import annotations

type Color = tuple[int, int, int]

ORANGE: Color = (230, 159, 0)
SKY: Color = (86, 180, 233)
GREEN: Color = (0, 158, 115)
YELLOW: Color = (240, 228, 66)
BLUE: Color = (0, 114, 178)
RED: Color = (213, 94, 0)
PINK: Color = (204, 121, 167)
GREY: Color = (130, 130, 130)

#: Where the hand was, where it is to be, where it would go; the parts of a model; where objects should be.
TRAIL, REFERENCE, PREVIEW, COMPONENT, SUGGESTED = BLUE, ORANGE, GREEN, PINK, SKY
#: How stiff the hand is held.
STIFFNESS = YELLOW
#: Of things beside each other, in this order.
SEVERAL = (ORANGE, SKY, GREEN, PINK, BLUE, YELLOW)
#: What is known of a frame: each has a word of its own beside the colour.
FRAME: dict[str, Color] = {"seen": GREEN, "held": YELLOW, "missing": RED, "refused": PINK, "fixed": GREY}


def css(color: Color) -> str:
    """A colour as style sheets write it."""
    return "rgb({}, {}, {})".format(*color)

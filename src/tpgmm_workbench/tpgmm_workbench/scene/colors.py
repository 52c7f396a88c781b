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
BLACK: Color = (0, 0, 0)
WHITE: Color = (255, 255, 255)

#: Where the hand was, where it is to be, where it would go; the parts of a model; where objects should be.
TRAIL, REFERENCE, PREVIEW, COMPONENT, SUGGESTED = BLUE, ORANGE, GREEN, PINK, SKY
#: How stiff the hand is held.
STIFFNESS = YELLOW
#: Of things beside each other, in this order.
SEVERAL = (ORANGE, SKY, GREEN, PINK, BLUE, YELLOW)
#: What is known of a frame: each has a word of its own beside the colour.
FRAME: dict[str, Color] = {"seen": GREEN, "held": YELLOW, "missing": RED, "refused": PINK, "fixed": GREY}


def luminance(color: Color) -> float:
    """Relative luminance of a colour, 0 to 1 (Web Content Accessibility Guidelines 2.2)."""
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (part / 255.0 for part in color)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: Color, other: Color) -> float:
    """How well one colour is read on another, 1 to 21; text needs 4.5 (the same guidelines)."""
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def readable_on(ground: Color) -> Color:
    """Black or white: the one that is read better on a ground."""
    return max(BLACK, WHITE, key=lambda color: contrast(color, ground))


def css(color: Color) -> str:
    """A colour as style sheets write it."""
    return "rgb({}, {}, {})".format(*color)

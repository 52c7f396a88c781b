# SPDX-License-Identifier: Apache-2.0
"""Pieces of HTML that panels are made of."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from tpgmm_workbench.scene.colors import Color, css, readable_on


def chip(text: str, color: Color) -> str:
    """A word on a coloured ground that can be read."""
    return (
        f'<span style="background:{css(color)};color:{css(readable_on(color))};border-radius:0.6em;'
        f'padding:0 0.5em;white-space:nowrap">{escape(text)}</span>'
    )


def block(lines: Iterable[str], style: str = "") -> str:
    """Lines of HTML, one below the other."""
    rows = "".join(f'<div style="margin:0.15em 0">{line}</div>' for line in lines)
    return f'<div style="font-size:0.85em;line-height:1.35;padding:0 0.6em;{style}">{rows}</div>'

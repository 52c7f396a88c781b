# SPDX-License-Identifier: Apache-2.0
"""Small pictures as SVG, for pages without anything from elsewhere: paths and ellipses in a plane, shares over time."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tpgmm_core.common.types import Array

COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#e377c2")
WIDTH, HEIGHT, MARGIN = 300, 260, 34


@dataclass
class Plane:
    """Paths and ellipses in one plane, in m, with the same scale in both directions.

    Attributes
    ----------
    title, across, up
        texts: of the picture, and of its axes
    paths
        points (T, 2), colour, opacity
    ellipses
        centre (2,), covariance (2, 2): drawn at two standard deviations
    """

    title: str
    across: str
    up: str
    paths: list[tuple[Array, str, float]] = field(default_factory=list)
    ellipses: list[tuple[Array, Array]] = field(default_factory=list)

    def draw(self) -> str:
        """The picture."""
        points = np.concatenate([path for path, _, _ in self.paths] + [centre[None] for centre, _ in self.ellipses])
        low, high = points.min(axis=0), points.max(axis=0)
        scale = float(min((WIDTH - 2 * MARGIN), (HEIGHT - 2 * MARGIN)) / max(1e-6, (high - low).max()))
        middle = 0.5 * (low + high)

        def placed(xy: Array) -> Array:
            flipped = (np.atleast_2d(xy) - middle) * scale * [1.0, -1.0]
            return np.asarray(flipped + [0.5 * WIDTH, 0.5 * HEIGHT])

        parts = [_polyline(placed(path), colour, opacity) for path, colour, opacity in self.paths]
        for centre, covariance in self.ellipses:
            values, axes = np.linalg.eigh(covariance)
            (x, y), (small, large) = placed(centre)[0], 2.0 * scale * np.sqrt(np.maximum(values, 0.0))
            angle = np.degrees(np.arctan2(-axes[1, 1], axes[0, 1]))
            parts.append(
                f'<ellipse cx="{x:.1f}" cy="{y:.1f}" rx="{large:.1f}" ry="{small:.1f}" '
                f'transform="rotate({angle:.1f} {x:.1f} {y:.1f})" fill="#ff7f0e" fill-opacity="0.18" stroke="#ff7f0e"/>'
            )
        step = _round_step(float((high - low).max()))
        parts.append(
            f'<line x1="{MARGIN}" y1="{HEIGHT - 12}" x2="{MARGIN + step * scale:.1f}" y2="{HEIGHT - 12}" '
            f'stroke="black"/><text x="{MARGIN}" y="{HEIGHT - 16}">{step:g} m</text>'
        )
        return _picture(parts, self.title, f"{self.across} →, {self.up} ↑")


def shares_over_time(shares: Mapping[str, Array], title: str) -> str:
    """Shares (M,) by name, one above the other, from the beginning of a movement to its end."""
    total, parts = np.zeros(len(next(iter(shares.values())))), []
    x = np.linspace(MARGIN, WIDTH - 8, len(total))
    height = HEIGHT - 2 * MARGIN
    for number, (name, values) in enumerate(shares.items()):
        lower, total = total, total + values
        outline = np.vstack([np.column_stack([x, total]), np.column_stack([x, lower])[::-1]])
        outline[:, 1] = HEIGHT - MARGIN - height * outline[:, 1]
        colour = COLOURS[number % len(COLOURS)]
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in outline)
        parts.append(f'<polygon points="{points}" fill="{colour}" fill-opacity="0.6"/>')
        at = int(np.argmax(values))
        y = HEIGHT - MARGIN - height * 0.5 * (lower[at] + total[at])
        anchor = "start" if at < len(total) / 3 else ("end" if at > 2 * len(total) / 3 else "middle")
        parts.append(f'<text x="{x[at]:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(name)}</text>')
    return _picture(parts, title, "0 % to 100 % of the movement →")


def legend(names: Sequence[str]) -> str:
    """Names in the colours of COLOURS."""
    return " ".join(
        f'<span style="color:{COLOURS[i % len(COLOURS)]}">━ {html.escape(name)}</span>' for i, name in enumerate(names)
    )


def _polyline(points: Array, colour: str, opacity: float) -> str:
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-opacity="{opacity}"/>'


def _picture(parts: Sequence[str], title: str, below: str) -> str:
    return (
        f'<svg role="img" aria-label="{html.escape(title)}" width="{WIDTH}" height="{HEIGHT}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}"><rect width="100%" height="100%" '
        f'fill="white" stroke="#ccc"/>{"".join(parts)}<text x="8" y="15" font-weight="bold">{html.escape(title)}</text>'
        f'<text x="{WIDTH - 8}" y="{HEIGHT - 5}" text-anchor="end">{html.escape(below)}</text></svg>'
    )


def _round_step(size: float) -> float:
    """A length of one digit, about a quarter of a size."""
    step = 0.25 * max(size, 1e-6)
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * max(1, round(step / power)))

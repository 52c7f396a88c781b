# SPDX-License-Identifier: Apache-2.0
"""The page of a training: whole in one file, with what was found, and with the reason where nothing was learned."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core import TPGMM
from tpgmm_ros.models.training_record import expected_errors
from tpgmm_ros.programs.svg import HEIGHT, MARGIN, WIDTH, Plane, shares_over_time
from tpgmm_ros.programs.train import main


class Page(HTMLParser):
    """Tags, pictures and texts of a page, all of whose tags have to be closed."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.source = path.read_text()
        self.feed(self.source)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [str(value) for name, value in attributes if name in ("src", "href")]
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture
def arguments(tmp_path: Path) -> list[str]:
    (tmp_path / "task.yaml").write_text(REACH_TASK)
    for i in range(4):
        write_bag(tmp_path / "bags" / f"demo_{i}", reach(i, samples=25))
    report = str(tmp_path / "out" / "page.html")
    return ["--task", str(tmp_path / "task.yaml"), "--components", "2", "--report", report, str(tmp_path / "bags")]


def test_a_training_is_one_page_with_all_of_it_and_nothing_from_elsewhere(arguments: list[str], tmp_path: Path) -> None:
    output = tmp_path / "reach.tpgmm"
    assert main([*arguments, "--leave-one-out", "--output", str(output)]) == 0
    page = Page(tmp_path / "out" / "page.html")
    assert page.links == [] and "http" not in page.source
    # two planes for each of two frames and of four demonstrations left out, and the shares of the frames
    assert page.tags.count("svg") == 4 + 8 + 1
    assert page.tags.count("ellipse") == 2 * 4, "two components in each view of a frame"
    assert page.tags.count("polyline") == 4 * 4 + 8 * 2 and page.tags.count("polygon") == 2
    errors = expected_errors(TPGMM.load(output))
    assert f"mean{errors['position_rmse_m']:.3f}{errors['position_end_m']:.3f}" in page.text
    assert "--leave-one-out --output" in page.text and "seen from object" in page.text and "Coverage" in page.text
    numbers = [float(x) for points in re.findall('points="([^"]*)"', page.source) for x in re.split("[ ,]", points)]
    assert 0.0 <= min(numbers) and max(numbers) <= max(WIDTH, HEIGHT)


def test_doubts_and_reasons_are_on_the_page_as_texts(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = reach(1, samples=25)
    topics["/endpoint/pose"] = replace(topics["/endpoint/pose"], poses=1000.0 * topics["/endpoint/pose"].poses)
    write_bag(tmp_path / "bags" / "<b>mm", topics)
    assert main([*arguments, "--output", str(tmp_path / "reach.tpgmm")]) == 1
    page = Page(tmp_path / "out" / "page.html")
    reason = re.findall("^error: (.*)$", capsys.readouterr().err, re.MULTILINE)[-1]
    assert f"Nothing was learned: {reason}" in page.text and "<b>mm" in page.text and "b" not in page.tags
    assert "svg" not in page.tags and "make sense" not in page.text


def test_a_picture_has_one_scale_and_keeps_what_it_shows_within_its_edges() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])
    text = Plane("a < b", "x", "y", [(square, "red", 1.0)]).draw()
    points = np.array([p.split(",") for p in re.findall('points="([^"]*)"', text)[0].split(" ")], float)
    steps = np.diff(points, axis=0)
    np.testing.assert_allclose(steps[0, 0] / -steps[1, 1], 2.0, atol=0.01)
    assert steps[1, 1] < 0.0, "up is up"
    assert points.min() >= MARGIN and "a &lt; b" in text
    shares = shares_over_time({"one": np.array([1.0, 0.25]), "two": np.array([0.0, 0.75])}, "t")
    lower = [p.split(",") for p in re.findall('points="([^"]*)"', shares)[1].split(" ")]
    assert float(lower[1][1]) == MARGIN and float(lower[2][1]) == HEIGHT - MARGIN - 0.25 * (HEIGHT - 2 * MARGIN)

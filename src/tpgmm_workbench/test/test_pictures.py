# SPDX-License-Identifier: Apache-2.0
"""Pictures of the scene: kept in the project's folder, given to whoever asked, and words where a browser is silent."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from tpgmm_workbench.desk.pictures import Pictures
from tpgmm_workbench.page import picture
from tpgmm_workbench.page.picture import LONGEST, USUAL, draw_of


class Background:
    """Does what it is given when it is told to."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Callable[[], Any], Callable[[Future[Any]], None]]] = []

    def run(self, work: Callable[[], Any], then: Callable[[Future[Any]], None]) -> None:
        self.jobs.append((work, then))

    def finish(self) -> None:
        for work, then in self.jobs:
            job: Future[Any] = Future()
            try:
                job.set_result(work())
            except (OSError, RuntimeError) as error:
                job.set_exception(error)
            then(job)
        self.jobs.clear()


class Browser:
    """A page of viser that answers, or does not."""

    def __init__(self, width: int, height: int, error: Exception | None = None) -> None:
        self.camera = SimpleNamespace(image_width=width, image_height=height)
        self.error = error
        self.asked: dict[str, Any] = {}

    def get_render(self, **asked: Any) -> np.ndarray:
        self.asked = asked
        if self.error is not None:
            raise self.error
        image = np.zeros((asked["height"], asked["width"], 3), np.uint8)
        image[:, : asked["width"] // 2] = (230, 159, 0)
        return image


def test_a_picture_is_kept_under_the_next_number_and_given_to_who_asked(tmp_path: Path) -> None:
    said: list[str] = []
    files: list[tuple[str, bytes]] = []
    background = Background()
    pictures = Pictures(SimpleNamespace(folder=tmp_path), background, said.append)  # type: ignore[arg-type]
    for number in (1, 2):
        pictures.take(draw_of(Browser(320, 240)), lambda *file: files.append(file))  # type: ignore[arg-type]
        assert "waiting" in pictures.words and len(said) == number - 1
        background.finish()
        assert pictures.words == f"pictures/000{number}.png in the project's folder: 320 x 240 pixels" == said[-1]
    assert [name for name, _ in files] == ["0001.png", "0002.png"]
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["0001.png", "0002.png"]
    assert (tmp_path / "pictures" / "0002.png").read_bytes() == files[1][1]
    image = imread(io.BytesIO(files[0][1]), format="png")
    np.testing.assert_allclose(image[120, 10, :3], np.array([230, 159, 0]) / 255.0, atol=1e-6)
    np.testing.assert_array_equal(image[120, 310, :3], 0.0)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (TimeoutError("Render request timed out"), "did not answer within"),
        (RuntimeError("Render request failed: the client disconnected"), "its page was closed"),
    ],
)
def test_a_browser_that_does_not_answer_keeps_nobody_waiting_and_is_told_of(
    tmp_path: Path, error: Exception, words: str
) -> None:
    said: list[str] = []
    background, given = Background(), []
    pictures = Pictures(SimpleNamespace(folder=tmp_path), background, said.append)  # type: ignore[arg-type]
    browser = Browser(320, 240, error)
    pictures.take(draw_of(browser), lambda *file: given.append(file))  # type: ignore[arg-type]
    assert not browser.asked, "who asks does not wait"
    pictures.take(draw_of(browser), lambda *file: given.append(file))  # type: ignore[arg-type]
    assert said == ["a picture is being taken: wait for it"] and len(background.jobs) == 1
    background.finish()
    assert browser.asked["timeout"] == picture.PATIENCE
    assert words in pictures.words and not given and not list(tmp_path.iterdir())
    browser.error = None
    pictures.take(draw_of(browser), lambda *file: given.append(file))  # type: ignore[arg-type]
    background.finish()
    assert len(given) == 1


def test_a_picture_is_as_large_as_the_page_up_to_a_limit() -> None:
    for size, asked in (((3840, 1920), (LONGEST, LONGEST // 2)), ((640, 360), (640, 360)), ((0, 0), USUAL)):
        browser = Browser(*size)
        draw_of(browser)()  # type: ignore[arg-type]
        assert (browser.asked["width"], browser.asked["height"]) == asked

# SPDX-License-Identifier: Apache-2.0
"""What someone does at the page while a skill runs: pauses, lets it go on and back, and pushes the arm."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from matplotlib.image import imread

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_workbench.page.camera import camera_for
from workbench_user import HEIGHT, WIDTH, Places, User

#: Sliders of the panel Run, from above.
DURATION, SPEED = 0, 1
#: Length of the hand's gizmo; how far it is pulled, and how far the hand follows at least, m.
HAND_GIZMO, PULLED, FOLLOWS = 0.22, 0.1, 0.015
#: A hand that moves by less while one looks twice stands still, m.
STANDS = 5e-4


def set_slider(user: User, slider: int, value: float) -> None:
    """Write a number beside a slider of the panel Run."""
    user.page.locator("input[inputmode=decimal]").nth(slider).fill(str(value))
    user.page.keyboard.press("Enter")


def share(user: User) -> int:
    """How much of the movement is done, as the page says, %."""
    found = re.search(r"(?:running|paused)\s+(\d+) %", user.text())
    return int(found[1]) if found else -1


def pause_and_go_back(user: User, places: Places, home: Array) -> None:
    """Pause by the key, push the arm that stands still, go on by a button, and back by the slider.

    Parameters
    ----------
    user
        at the panel Run, while the skill runs
    places
        of the hand
    home
        (7,) where the hand is at home, and the camera looks
    """
    user.until(lambda: share(user) > 2, "the beginning of the movement")
    user.page.keyboard.press("Space")
    user.sees("paused")
    _stands(user, places)
    paused = share(user)
    _push(user, places, home)
    _stands(user, places)
    assert (now := share(user)) == paused, f"a pause is a pause: {paused} %, then {now} %"
    user.shoot("paused")
    user.click("Go on [G]")
    user.until(lambda: share(user) > paused, "the movement to go on")
    set_slider(user, SPEED, -1)
    far: list[int] = []

    def goes_back() -> bool:
        far.append(share(user))
        return 0 <= far[-1] < max(far)

    user.until(goes_back, "the movement to go back")
    set_slider(user, SPEED, 1)
    least = share(user)
    user.until(lambda: share(user) > least, "the movement to go forward again")


def take_picture(user: User, folder: Path, download: Path) -> None:
    """Take a picture of the scene: it lies in the project's `folder`, and comes as a file, saved as `download`."""
    with user.page.expect_download() as got:
        user.click("Take a picture")
    got.value.save_as(download)
    user.sees("pictures/0001.png in the project's folder")
    assert download.read_bytes() == (folder / "pictures" / "0001.png").read_bytes()
    picture = imread(download)
    assert picture.shape == (HEIGHT, WIDTH, 4) and np.ptp(picture[:, :, :3]) > 0.5


def _stands(user: User, places: Places) -> None:
    """Wait until the hand stands still, and the page, which is late where the browser draws slowly, says no more."""
    before = places.of("hand"), share(user)

    def stands() -> bool:
        nonlocal before
        user.rest(0.5)
        (pose, said), before = before, (places.of("hand"), share(user))
        return pose_error(before[0], pose)[0] < STANDS and before[1] == said

    user.until(stands, "the hand to stand still")


def _push(user: User, places: Places, home: Array) -> None:
    """Take hold of the hand's gizmo: the arm yields, the page says that it is held, and that it is let go of."""
    was = places.of("hand")
    with user.holding(was, axis=0, way=PULLED, camera=camera_for(home), length=HAND_GIZMO):
        user.until(lambda: pose_error(places.of("hand"), was)[0] > FOLLOWS, "the hand to be pushed aside")
        user.sees("the hand is held (more than")
        user.shoot("pushed")
    user.sees("the hand was let go of")
    user.until(lambda: pose_error(places.of("hand"), was)[0] < FOLLOWS, "the hand to come back")

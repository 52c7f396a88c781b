# SPDX-License-Identifier: Apache-2.0
"""Asks a browser to draw what it shows. It may be slow, or gone: who asks waits, so never the server's thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import ClientHandle

#: A browser without a graphics card needs seconds, s.
PATIENCE = 20.0
#: Longest side of a picture, pixels; what is asked for where a page does not say how large it is.
LONGEST, USUAL = 1920, (1280, 720)


def draw_of(client: ClientHandle) -> Callable[[], NDArray[np.uint8]]:
    """What draws the scene as a page shows it now.

    Parameters
    ----------
    client
        the page; it has told where its camera is

    Returns
    -------
    Callable[[], NDArray[np.uint8]]
        waits for the picture (H, W, 3), and raises OSError or RuntimeError where none comes
    """
    camera = client.camera
    size = camera.image_width, camera.image_height
    width, height = size if min(size) > 0 else USUAL
    scale = min(1.0, LONGEST / max(width, height))
    asked: dict[str, Any] = {"height": round(scale * height), "width": round(scale * width), "timeout": PATIENCE}

    def draw() -> NDArray[np.uint8]:
        try:
            return np.asarray(client.get_render(**asked), dtype=np.uint8)[:, :, :3]
        except TimeoutError:
            raise TimeoutError(f"the browser did not answer within {PATIENCE:g} s: is its page in view?") from None
        except RuntimeError:  # it says so, or it is gone
            raise RuntimeError("the browser gave no picture, or its page was closed") from None

    return draw

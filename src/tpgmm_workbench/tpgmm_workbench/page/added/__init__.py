# SPDX-License-Identifier: Apache-2.0
"""What is added to viser's page before it is served: it says when nothing is heard, and its words can be read."""

from __future__ import annotations

import gzip
from functools import cache
from importlib.resources import files

from websockets.http11 import Response

#: Of an element that the page has as soon as the server hears it; heard.js looks for it.
MARK = "tpgmm-heard"
_END_OF_HEAD = b"</head>"


@cache
def _head() -> bytes:
    here = files(__name__)
    style, script = (here.joinpath(name).read_text(encoding="utf-8") for name in ("readable.css", "heard.js"))
    return f"<style>{style}</style><script>{script}</script>".encode()


@cache
def _completed(body: bytes, is_packed: bool) -> bytes:
    page = gzip.decompress(body) if is_packed else body
    if _END_OF_HEAD not in page:
        return body
    page = page.replace(_END_OF_HEAD, _head() + _END_OF_HEAD, 1)
    return gzip.compress(page) if is_packed else page


def completed(answer: Response) -> Response:
    """Add style and script to a page.

    Parameters
    ----------
    answer
        of the server: the page, or anything else

    Returns
    -------
    Response
        the same; a page with what is added at the end of its head
    """
    if answer.status_code == 200 and answer.headers.get("Content-Type", "").startswith("text/html"):
        answer.body = _completed(bytes(answer.body), answer.headers.get("Content-Encoding") == "gzip")
        del answer.headers["Content-Length"]
        answer.headers["Content-Length"] = str(len(answer.body))
    return answer

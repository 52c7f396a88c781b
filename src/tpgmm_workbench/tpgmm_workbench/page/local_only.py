# SPDX-License-Identifier: Apache-2.0
"""A page that answers only itself: requests that other web sites make in the user's browser are refused.

A server on 127.0.0.1 is out of reach for other machines, but not for pages of other sites that are open in the same
browser: these may open a web socket to it, or give a name of their own this address. viser does not look at who asks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server as server
from websockets.datastructures import Headers
from websockets.http11 import Response

_OWN = ("127.0.0.1", "localhost")


def is_of_this_machine(host: str | None, origin: str | None) -> bool:
    """Whether a request comes from the page itself, or from no page.

    Parameters
    ----------
    host
        what the request calls the server, with or without a port
    origin
        of the page that asks, as its browser says; None where no page asks

    Returns
    -------
    bool
        whether it is to be answered
    """
    if urlsplit(f"//{host or ''}").hostname not in _OWN:
        return False
    return origin is None or (urlsplit(origin).hostname in _OWN and urlsplit(origin).netloc == host)


@contextmanager
def local_only() -> Iterator[None]:
    """Servers of web sockets that are started within this block refuse what others ask for."""
    serve = server.serve

    def guarded(*arguments: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        async def check(connection: Any, request: Any) -> Any:
            if not is_of_this_machine(request.headers.get("Host"), request.headers.get("Origin")):
                return Response(HTTPStatus.FORBIDDEN, "FORBIDDEN", Headers(), b"this page answers this machine alone\n")
            answer: Any = None if process_request is None else process_request(connection, request)
            return await answer if hasattr(answer, "__await__") else answer

        return serve(*arguments, process_request=check, **options)

    server.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]

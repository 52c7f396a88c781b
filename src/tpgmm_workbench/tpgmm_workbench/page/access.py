# SPDX-License-Identifier: Apache-2.0
"""Who may see the page: this machine alone, or other machines too, whose users know a token.

A server on 127.0.0.1 is out of reach for other machines, but not for pages of other sites that are open in the same
browser: these may open a web socket to it, or give a name of their own this address. viser does not look at who asks.
A page that other machines reach asks for a token, on this machine too: who has it may move the robot. It comes once, in
the address; from then on the browser has it as a cookie, so that it stands in no address that is seen or copied.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server as server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

#: Names that this machine alone knows as its own; addresses that stand for all networks that it is in.
OWN = ("127.0.0.1", "localhost")
EVERY = ("0.0.0.0", "::")
#: Random bytes of a token: nobody finds 128 bits by trying.
TOKEN_BYTES = 16


def is_of_this_machine(host: str | None, origin: str | None) -> bool:
    """Whether a request comes from the page itself, or from no page, on this machine.

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
    return urlsplit(f"//{host or ''}").hostname in OWN and _is_of_the_page(host, origin)


def _is_of_the_page(host: str | None, origin: str | None) -> bool:
    return origin is None or (bool(host) and urlsplit(origin).netloc == host)


class Access:
    """Who is answered.

    Parameters
    ----------
    host
        address at which the page is served: 127.0.0.1, or one that other machines reach

    Attributes
    ----------
    host
        as given
    token
        that users need; "" where this machine alone is answered

    Raises
    ------
    ValueError
        for a host that is no address of this machine
    """

    def __init__(self, host: str = OWN[0]) -> None:
        try:
            family, _, _, _, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
            with socket.socket(family) as trial:
                trial.bind(place)
        except OSError as error:
            raise ValueError(
                f"host {host!r} is no address of this machine ({error.strerror}): give {OWN[0]} for this machine "
                f"alone, {EVERY[0]} for all networks that it is in, or its address in one of them"
            ) from error
        self.host = host
        self.token = "" if host in OWN else secrets.token_urlsafe(TOKEN_BYTES)
        # cookies are of a machine, whatever the port: two pages on it must not take each other's
        self._cookie = f"tpgmm_{hashlib.sha256(self.token.encode()).hexdigest()[:8]}"

    def address(self, port: int) -> str:
        """Where the page is, as a user opens it first; with the token, where one is needed."""
        host = socket.gethostname() if self.host in EVERY else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{port}" + (f"/?token={self.token}" if self.token else "")

    def answer(self, request: Request) -> Response | None:
        """What a request is told instead of what it asks for; None where it may have that.

        Parameters
        ----------
        request
            for the page, or for a web socket

        Returns
        -------
        Response | None
            a refusal; or, to who comes with the token, the page's address without it, and a cookie
        """
        host, origin = request.headers.get("Host"), request.headers.get("Origin")
        if not self.token:
            return None if is_of_this_machine(host, origin) else _refusal("this page answers this machine alone")
        if not _is_of_the_page(host, origin):
            return _refusal("this page answers no other site")
        if self._is_known(request.headers.get_all("Cookie")):
            return None
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if not self._is_token(given):
            return _refusal("this page needs its token: open the address that the workbench has printed")
        cookie = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
        return _response(HTTPStatus.SEE_OTHER, "", Location="/", Set_Cookie=cookie)

    def _is_known(self, cookies: list[str]) -> bool:
        try:
            found = [SimpleCookie(text).get(self._cookie) for text in cookies]
        except CookieError:
            return False
        return any(one is not None and self._is_token(one.value) for one in found)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self.token.encode())


def _refusal(words: str) -> Response:
    return _response(HTTPStatus.FORBIDDEN, words)


def _response(status: HTTPStatus, words: str, **further: str) -> Response:
    body = f"{words}\n".encode() if words else b""
    headers = {
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
    }
    headers |= {name.replace("_", "-"): value for name, value in further.items()}
    return Response(status, status.phrase, Headers(headers), body)


@contextmanager
def guarded(access: Access, complete: Callable[[Response], Response] = lambda answer: answer) -> Iterator[None]:
    """Servers of web sockets that are started within this block answer those alone who may see the page.

    Parameters
    ----------
    access
        who may
    complete
        changes what they get before it is sent
    """
    serve = server.serve

    def start(*arguments: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        async def check(connection: Any, request: Any) -> Any:
            refusal = access.answer(request)
            if refusal is not None:
                return refusal
            answer: Any = None if process_request is None else process_request(connection, request)
            answer = await answer if hasattr(answer, "__await__") else answer
            if answer is not None:  # no other site shows the page within its own, where clicks could be led astray
                answer.headers["X-Frame-Options"] = "DENY"
                answer = complete(answer)
            return answer

        return serve(*arguments, process_request=check, **options)

    server.serve = start  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]

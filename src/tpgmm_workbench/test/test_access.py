# SPDX-License-Identifier: Apache-2.0
"""Pages of other sites cannot reach the workbench; users of other machines can where they may, and have the token."""

from __future__ import annotations

import gzip
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.client import HTTPMessage
from typing import Any

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tpgmm_workbench.page.access import Access, guarded, is_of_this_machine
from tpgmm_workbench.page.added import MARK, completed

PROTOCOL: Any = [f"viser-v{viser.__version__}"]


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with guarded(Access(), completed):
        server = viser.ViserServer("127.0.0.1", 28080, verbose=False)
    yield server.get_port()
    server.stop()


@pytest.fixture(scope="module")
def opened() -> Iterator[tuple[Access, int]]:
    access = Access("0.0.0.0")
    with guarded(access):
        server = viser.ViserServer(access.host, 28180, verbose=False)
    yield access, server.get_port()
    server.stop()


class _Stay(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        return None


def asked(port: int, path: str = "/", **headers: str) -> tuple[int, HTTPMessage]:
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers=headers)
    try:
        with urllib.request.build_opener(_Stay).open(request, timeout=20.0) as answer:
            return int(answer.status), answer.headers
    except urllib.error.HTTPError as error:
        return error.code, error.headers


def test_the_page_is_served_to_this_machine_and_to_no_other_name_and_stands_in_no_other_page(port: int) -> None:
    status, headers = asked(port)
    assert status == 200 and headers["X-Frame-Options"] == "DENY"
    assert asked(port, Host="evil.example")[0] == 403


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_is_served_with_what_says_that_it_is_not_heard(port: int, encoding: str) -> None:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/", headers={"Accept-Encoding": encoding})
    with urllib.request.build_opener().open(request, timeout=20.0) as answer:
        body = answer.read()
        assert int(answer.headers["Content-Length"]) == len(body)
    page = gzip.decompress(body) if encoding == "gzip" else body
    head = page[: page.index(b"</head>")]
    assert f'"{MARK}"'.encode() in head and b"dimmed" in head and page.count(b"</head>") == 1


def test_a_web_socket_is_opened_for_the_page_itself_and_for_no_other_site(port: int) -> None:
    own = f"http://127.0.0.1:{port}"
    with connect(f"ws://127.0.0.1:{port}", origin=own, subprotocols=PROTOCOL):
        pass
    for other in ("https://evil.example", f"http://127.0.0.1:{port + 1}", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{port}", origin=other)


@pytest.mark.parametrize(
    ("host", "origin", "answered"),
    [
        ("127.0.0.1:8080", None, True),
        ("localhost:8080", "http://localhost:8080", True),
        ("localhost:8080", "http://127.0.0.1:8080", False),
        ("127.0.0.1.evil.example", None, False),
        (None, None, False),
    ],
)
def test_who_is_answered(host: str | None, origin: str | None, answered: bool) -> None:
    assert is_of_this_machine(host, origin) is answered


def test_a_page_that_is_open_to_other_machines_answers_those_alone_who_have_its_token(
    opened: tuple[Access, int],
) -> None:
    access, port = opened
    own, socket = f"http://127.0.0.1:{port}", f"ws://127.0.0.1:{port}"
    assert access.address(port).endswith(f":{port}/?token={access.token}") and len(access.token) >= 20
    for path in ("/", "/?token=", f"/?token={access.token[:-1]}", "/?token=%ff", f"/{access.token}"):
        assert asked(port, path)[0] == 403, path
    assert asked(port, Cookie=f"tpgmm={access.token}")[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        connect(socket, origin=own, subprotocols=PROTOCOL)

    # the token goes from the address into a cookie that no script reads, and that other sites do not send
    status, headers = asked(port, f"/?token={access.token}")
    assert status == 303 and headers["Location"] == "/" and headers["Cache-Control"] == "no-store"
    cookie, *options = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Lax"} <= set(options)
    assert asked(port, Cookie=f"other=1; {cookie}")[0] == 200
    with connect(socket, origin=own, subprotocols=PROTOCOL, additional_headers={"Cookie": cookie}):
        pass
    with pytest.raises(InvalidStatus, match="403"):
        connect(socket, origin="https://evil.example", subprotocols=PROTOCOL, additional_headers={"Cookie": cookie})


def test_each_page_has_a_token_of_its_own_and_this_machine_alone_needs_none() -> None:
    assert Access("0.0.0.0").token != Access("0.0.0.0").token
    assert Access().token == "" and Access().address(8080) == "http://127.0.0.1:8080"
    assert Access("127.0.0.2").address(8080).startswith("http://127.0.0.2:8080/?token=")
    with pytest.raises(ValueError, match="no address of this machine.*127.0.0.1 for this machine alone"):
        Access("192.0.2.1")

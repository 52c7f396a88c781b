# SPDX-License-Identifier: Apache-2.0
"""Pages of other sites, open in the same browser, cannot reach the workbench."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tpgmm_workbench.page.local_only import is_of_this_machine, local_only


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with local_only():
        server = viser.ViserServer("127.0.0.1", 28080, verbose=False)
    yield server.get_port()
    server.stop()


def asked(port: int, **headers: str) -> int:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=20.0) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code


def test_the_page_is_served_to_this_machine_and_to_no_other_name(port: int) -> None:
    assert asked(port) == 200
    assert asked(port, Host="evil.example") == 403


def test_a_web_socket_is_opened_for_the_page_itself_and_for_no_other_site(port: int) -> None:
    own = f"http://127.0.0.1:{port}"
    with connect(f"ws://127.0.0.1:{port}", origin=own, subprotocols=[f"viser-v{viser.__version__}"]):
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

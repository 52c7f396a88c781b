# SPDX-License-Identifier: Apache-2.0
"""A page of the workbench without a browser: it has what a browser would show, can press buttons, and draws nothing.

It speaks viser's protocol: messages are packed together, compressed, and followed by arrays as they are in memory.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from typing import Any, Literal

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

#: Bytes of each of the two lengths before the compressed messages, and of the steps at which arrays begin after them.
_LENGTH = 8
#: A window of this size, in pixels; the server hears a page as soon as it tells where its camera is.
_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (1.0, 0.0, 0.0),
    "fov": 0.9,
    "near": 0.1,
    "far": 10.0,
    "image_height": 240,
    "image_width": 320,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
#: Of the text that each page has of its own.
OWN = "tpgmm-heard"
#: (name of a node of the scene, or id of a box or text; property) -> value
type State = dict[tuple[str, str], Any]


class PageClient:
    """What one page has been sent.

    Attributes
    ----------
    frames, bytes, messages, repeated
        how many were sent: packets, their bytes, messages in them, and messages that change nothing
    scene, panels, notices
        what it shows; notices are for this page alone
    """

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self._listening = asyncio.create_task(self.listen())
        self.frames = self.bytes = self.messages = self.repeated = 0
        self.scene: State = {}
        self.panels: State = {}
        self.notices: State = {}

    async def listen(self) -> None:
        """Take what comes, until the connection ends."""
        async for packet in self._socket:
            assert isinstance(packet, bytes)
            self._take(packet)

    def _take(self, packet: bytes) -> None:
        begin = 2 * _LENGTH
        end = begin + int.from_bytes(packet[_LENGTH:begin], "little")
        content = msgspec.msgpack.decode(zstandard.decompress(packet[begin:end]))
        arrays = []
        for length in content["binaryBufferLengths"]:
            end += -end % _LENGTH
            arrays.append(packet[end : end + length])
            end += length
        self.frames += 1
        self.bytes += len(packet)
        for message in content["messages"]:
            self.messages += 1
            self.repeated += not self._changes(_filled(message, arrays))

    def _changes(self, message: Mapping[str, Any]) -> bool:
        """Take one message in; whether anything is different by it."""
        kind = str(message["type"])
        state = self.notices if kind.startswith("Notification") else self.panels if "uuid" in message else self.scene
        of = str(message.get("uuid", message.get("name", kind)))
        if kind.startswith("Remove") or kind == "GuiRemoveMessage":
            gone = [key for key in state if key[0] == of]
            for key in gone:
                del state[key]
            return bool(gone)
        parts = {**message.get("updates", {}), **message.get("props", {})}
        own = {key: value for key, value in message.items() if key not in ("type", "name", "uuid", "updates", "props")}
        told = {(of, key): value for key, value in {**own, **parts}.items()}
        changed = any(key not in state or state[key] != value for key, value in told.items())
        state.update(told)
        return changed or not told

    @property
    def text(self) -> str:
        """All that stands on the page, without its marks."""
        return re.sub("<[^>]*>", " ", " ".join(str(v) for (_, key), v in self.panels.items() if key == "content"))

    @property
    def shared(self) -> State:
        """What it shows, without what it is told alone."""
        own = {of for (of, _), value in self.panels.items() if OWN in str(value)}
        return self.scene | {key: value for key, value in self.panels.items() if key[0] not in own}

    async def press(self, label: str, option: str | None = None) -> None:
        """Press a button by the begin of its label; of a group of buttons, one of them.

        Raises
        ------
        KeyError
            where the page has none
        """
        await self._set(self._button(label, option is not None), option or True)

    def offers(self, label: str) -> bool:
        """Whether a group of buttons, by the begin of its label, is to be seen."""
        return bool(self.panels.get((self._button(label, True), "visible"), True))

    def _button(self, label: str, is_group: bool) -> str:
        for (of, key), value in self.panels.items():
            if key == "label" and str(value).startswith(label) and is_group == ((of, "options") in self.panels):
                return of
        raise KeyError(f"no button {label!r} on the page")

    async def set(self, label: str, value: float | bool) -> None:
        """Move a slider, or tick a box, by its label. Raises StopIteration where the page has none."""
        await self._set(next(of for (of, key), said in self.panels.items() if (key, said) == ("label", label)), value)

    async def key(self, key: str) -> None:
        """Press a key of the keyboard. Raises StopIteration where the page hears none such."""
        of = next(of for (of, what), said in self.panels.items() if (what, said) == ("hotkey", key))
        await self.send({"type": "CommandTriggerMessage", "uuid": of})

    async def drag(self, name: str, phase: Literal["start", "update", "end"], x: float = 0.0) -> None:
        """Take hold of a gizmo, move it to x (m), or let go of it."""
        placed = {"position": (x, 0.0, 0.0), "wxyz": (1.0, 0.0, 0.0, 0.0)} if phase == "update" else {}
        step = "Update" if phase == "update" else f"Drag{phase.title()}"
        await self.send({"type": f"TransformControls{step}Message", "name": name, "owner": "", **placed})

    async def close(self) -> None:
        """Take nothing more."""
        self._listening.cancel()
        await asyncio.gather(self._listening, return_exceptions=True)

    async def _set(self, of: str, value: float | bool | str) -> None:
        await self.send({"type": "GuiUpdateMessage", "uuid": of, "updates": {"value": value}})

    async def send(self, message: Mapping[str, Any]) -> None:
        """Send a message of viser's protocol, as a browser does."""
        await self._socket.send(msgspec.msgpack.encode(message))

    async def until(self, condition: Callable[[], object], what: str, timeout: float = 60.0) -> None:
        """Wait for something that the page has been sent. Raises TimeoutError or ConnectionError with what it is."""
        try:
            async with asyncio.timeout(timeout):
                while not condition():
                    if self._listening.done():
                        await self._listening
                        raise ConnectionError(f"the page was closed before: {what}")
                    await asyncio.sleep(0.02)
        except TimeoutError:
            raise TimeoutError(f"not within {timeout} s: {what}; the page says {self.text[:1000]}") from None


def _filled(value: Any, arrays: Sequence[bytes]) -> Any:
    """A message with its arrays, which stand at the end of the packet."""
    if isinstance(value, dict):
        if "__binary_index" in value:
            return arrays[value["__binary_index"]]
        return {key: _filled(part, arrays) for key, part in value.items()}
    return value


@contextlib.asynccontextmanager
async def open_page(address: str) -> AsyncIterator[PageClient]:
    """A page that is open within this block.

    Parameters
    ----------
    address
        of the workbench, http://...

    Yields
    ------
    PageClient
        that has been heard by the server
    """
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    async with connect(
        address.replace("http", "ws", 1), subprotocols=[protocol], compression=None, max_size=None
    ) as socket:
        page = PageClient(socket)
        try:
            await page.send(_CAMERA)
            await page.until(lambda: OWN in str(page.panels), "the page to be heard")
            yield page
        finally:
            await page.close()

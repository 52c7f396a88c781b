# SPDX-License-Identifier: Apache-2.0
"""Messages that nobody should send, of any type: every field by its declared type, from a good message or an empty one.

Nothing here knows a node: whoever subscribes to a topic gets what its type permits.
"""

from __future__ import annotations

import copy
import importlib
import re
from array import array
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.serialization import serialize_message

_ARRAY = re.compile(r"(?P<item>.+)\[(?P<size>\d+)\]")
_SEQUENCE = re.compile(r"sequence<(?P<item>.+?)(, (?P<most>\d+))?>")
_INTEGER = re.compile(r"(?P<u>u?)int(?P<bits>8|16|32|64)")
FLOATS = (
    0.0,
    -0.0,
    5e-324,
    -1e-320,
    1e-310,
    2.3e-308,
    1e-200,
    1e-9,
    1.0,
    -1.0,
    1e9,
    1e17,
    1e155,
    1e200,
    -1e300,
    1.7e308,
)
NOT_FINITE = (np.nan, np.inf, -np.inf)
TEXTS = ("", "base", "a\0b", "\n\x1b[31mred", "é🙂\u202e", "../../etc", "%s%n{0}", "x" * 300, "y" * 1_000_000)
SIZES = (0, 1, 2, 7, 36, 257, 3000)


def message_class(name: str) -> Any:
    """The class of a type, as "geometry_msgs/msg/PoseStamped"."""
    package, _, kind = name.replace("/msg/", "/").partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def subscriptions(node: Node, name: str) -> dict[str, Any]:
    """What a running node subscribes to: the class of each topic."""
    found = node.get_subscriber_names_and_types_by_node(name, "/")
    return {topic: message_class(types[0]) for topic, types in found}


class Fuzz:
    """A source of hostile messages; the same seed gives the same ones."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def spoiled(self, good: Any) -> Any:
        """A copy of a message in which one field, some, or all have become what nobody expects."""
        message = copy.deepcopy(good)
        share = float(self._rng.choice([0.0, 0.1, 0.5, 1.0]))
        if share:
            self._spoil(message, share)
        else:
            self._spoil_one(message)
        return message

    def damaged(self, good: Any) -> bytes:
        """The bytes of a message, cut, with some overwritten, or any bytes: a peer of another version, or a bad one."""
        written = serialize_message(good)
        kind = self._rng.integers(3)
        if kind == 0:
            return written[: int(self._rng.integers(4, len(written)))]  # 4: what says how they are to be read
        if kind == 1:
            place = int(self._rng.integers(4, max(5, len(written) - 4)))
            return written[:place] + bytes(self._rng.choice([0xFF, 0x7F, 0x00], 4).tolist()) + written[place + 4 :]
        return written[:4] + self._rng.bytes(int(self._rng.integers(len(written) - 3)))

    def number(self) -> float:
        kind = self._rng.integers(4)
        if kind == 0:
            return float(self._rng.choice(NOT_FINITE))
        if kind == 1:
            return float(self._rng.choice(FLOATS))
        return float(self._rng.choice([-1.0, 1.0]) * 10.0 ** self._rng.uniform(-320, 308))

    def _spoil_one(self, message: Any) -> None:
        """One leaf, somewhere."""
        fields = message.get_fields_and_field_types()
        name = str(self._rng.choice(list(fields)))
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            self._spoil_one(value)
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            self._spoil_one(value[int(self._rng.integers(len(value)))])
        elif len(value) if isinstance(value, array | np.ndarray) else False:
            value[int(self._rng.integers(len(value)))] = self._like(value)
        else:
            setattr(message, name, self._value(fields[name], value, 1.0))

    def _like(self, values: Any) -> Any:
        is_float = values.typecode in "df" if isinstance(values, array) else values.dtype.kind == "f"
        return self.number() if is_float else 0

    def _spoil(self, message: Any, share: float) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            setattr(message, name, self._value(kind, getattr(message, name), share))

    def _value(self, kind: str, old: Any, share: float) -> Any:
        if hasattr(old, "get_fields_and_field_types"):
            self._spoil(old, share)
            return old
        if self._rng.random() > share:
            return old
        if fixed := _ARRAY.fullmatch(kind):
            return [self._item(fixed["item"], share) for _ in range(int(fixed["size"]))]
        if sequence := _SEQUENCE.fullmatch(kind):
            return self._sequence(sequence["item"], old, int(sequence["most"] or 10**9), share)
        return self._item(kind, share)

    def _sequence(self, kind: str, old: Any, most: int, share: float) -> Any:
        """As long as it was, or not."""
        size = len(old) if self._rng.random() < 0.6 else int(self._rng.choice(SIZES))
        if "/" in kind:
            size = min(size, 300)
        items = [self._item(kind, share) for _ in range(min(size, most))]
        if "/" in kind and len(old) == size:
            for item in old:
                self._spoil(item, share)
            return old
        return array("d", items) if kind == "double" else items

    def _item(self, kind: str, share: float) -> Any:
        if kind in ("double", "float"):
            return self.number() if kind == "double" else float(np.clip(np.nan_to_num(self.number()), -3e38, 3e38))
        if integer := _INTEGER.fullmatch(kind):
            bits = int(integer["bits"])
            low, high = (0, 2**bits - 1) if integer["u"] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            near = [low, low + 1, 0, 1, 2, 999_999_999, 1_000_000_000, high - 1, high]
            return min(max(int(self._rng.choice(np.array(near, dtype=object))), low), high)
        if kind.startswith(("string", "wstring")):
            return str(self._rng.choice(np.array(TEXTS, dtype=object)))
        if kind == "boolean":
            return bool(self._rng.integers(2))
        if kind == "octet":
            return bytes([int(self._rng.integers(256))])
        message = message_class(kind)()
        self._spoil(message, share)
        return message

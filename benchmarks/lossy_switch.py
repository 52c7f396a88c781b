# SPDX-License-Identifier: Apache-2.0
"""Hosts on one machine, joined by a switch that loses packets, is slow, and may be unplugged (Linux).

Each host is a network namespace of its own, with one interface; the other end of its cable is here, and what comes from
one is sent on to the others by this program. No privileges are needed where the system permits user namespaces: the
whole runs in one, and leaves the machine's own network alone.
"""

from __future__ import annotations

import heapq
import os
import random
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

#: Packets that wait for a cable are dropped beyond this, bytes, as switches do.
QUEUE = 20_000
#: What a host publishes for the others has names below this.
NETWORK = "network"
_INSIDE = "TPGMM_OWN_NETWORK"
_ETH_P_ALL, _OUTGOING = 3, 4  # linux/if_ether.h, linux/if_packet.h


def enter_own_network() -> None:
    """Start this program anew in namespaces of its own, unless it is there.

    Raises
    ------
    SystemExit
        the system permits no user namespaces, or tools are missing
    """
    if os.environ.get(_INSIDE):
        return
    test = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--net", "ip", "link"], capture_output=True, text=True
    )
    if test.returncode:
        sys.exit(f"no network namespaces here: {test.stderr.strip()}; needs unshare, nsenter, ip, and user namespaces")
    os.environ[_INSIDE] = "1"
    command = ["unshare", "--user", "--map-root-user", "--net", sys.executable, *sys.orig_argv[1:]]
    os.execvp(command[0], command)


def require_own_network() -> None:
    """Refuse to go on where other machines could see this program.

    Raises
    ------
    SystemExit
        `enter_own_network` did not start it
    """
    if not os.environ.get(_INSIDE):
        sys.exit("this program runs on a host of its own: start benchmarks/networks.py")


class Host:
    """A network namespace with the address 10.77.0.NUMBER on its interface eth0."""

    def __init__(self, name: str, number: int) -> None:
        self.name = name
        self._keeper = subprocess.Popen(["unshare", "--net", "sleep", "infinity"])
        own = os.readlink("/proc/self/ns/net")
        while os.readlink(f"/proc/{self._keeper.pid}/ns/net") == own:
            time.sleep(0.01)
        cable = f"cable{number}"
        inner = ("type", "veth", "peer", "name", "eth0", "netns", str(self._keeper.pid))
        subprocess.run(["ip", "link", "add", cable, *inner], check=True)
        subprocess.run(["ip", "link", "set", cable, "up"], check=True)
        for words in ("link set lo up", f"addr add 10.77.0.{number}/24 dev eth0", "link set eth0 up",
                      "route add 224.0.0.0/4 dev eth0"):  # fmt: skip
            subprocess.run([*self._enter(), "ip", *words.split()], check=True)
        self.cable = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
        self.cable.bind((cable, 0))
        self.cable.setblocking(False)

    def _enter(self) -> list[str]:
        return ["nsenter", "--net", "--target", str(self._keeper.pid)]

    def start(self, command: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        """Start a program on this host; options of Popen."""
        return subprocess.Popen([*self._enter(), *command], text=True, start_new_session=True, **options)

    def close(self) -> None:
        """The end of the host; its programs have to be ended before."""
        self.cable.close()
        self._keeper.kill()
        self._keeper.wait()


class LossySwitch:
    """Sends frames on between hosts, in a thread of its own, until it is closed.

    Parameters
    ----------
    hosts
        joined by it
    loss
        share of the frames that are lost, each on its own
    rate
        of each cable in each direction, bit/s
    seed
        of the losses
    """

    def __init__(self, hosts: Sequence[Host], loss: float, rate: float, seed: int = 0) -> None:
        self._hosts, self._loss, self._rate = hosts, loss, rate
        self._random = random.Random(seed)
        self._where: dict[bytes, int] = {}  # address -> number of the host
        self._free_at = [[0.0, 0.0] for _ in hosts]  # when a cable has sent what waits: from the host, to it
        self._waiting: list[tuple[float, int, bytes]] = []
        self._unplugged: dict[str, float] = {}
        self.counts = {"sent": 0, "lost": 0, "queue full": 0, "unplugged": 0}
        self._ends = False
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def unplug(self, name: str, duration: float) -> None:
        """Nothing comes from a host and nothing gets there for a while, s."""
        self._unplugged[name] = time.monotonic() + duration

    def close(self) -> None:
        """End the thread."""
        self._ends = True
        self._thread.join()

    def _serve(self) -> None:
        cables = {host.cable.fileno(): i for i, host in enumerate(self._hosts)}
        poll = select.poll()
        for number in cables:
            poll.register(number, select.POLLIN)
        while not self._ends:
            wait = self._waiting[0][0] - time.monotonic() if self._waiting else 0.05
            for number, _ in poll.poll(max(0.0, 1e3 * min(wait, 0.05))):
                self._take(cables[number])
            now = time.monotonic()
            while self._waiting and self._waiting[0][0] <= now:
                _, to, frame = heapq.heappop(self._waiting)
                self._pass_on(to, frame)

    def _pass_on(self, to: int, frame: bytes) -> None:
        try:
            self._hosts[to].cable.send(frame)
            self.counts["sent"] += 1
        except OSError:  # longer than the cable takes, or its own queue is full
            self.counts["queue full"] += 1

    def _take(self, come_from: int) -> None:
        while True:
            try:
                frame, address = self._hosts[come_from].cable.recvfrom(65536)
            except BlockingIOError:
                return
            if address[2] == _OUTGOING:
                continue
            self._where[frame[6:12]] = come_from
            known = None if frame[0] & 1 else self._where.get(frame[:6])
            others = [i for i in range(len(self._hosts)) if i != come_from]
            if known == come_from or self._is_dropped(come_from, len(frame)):
                continue
            for to in others if known is None else [known]:
                self._queue(come_from, to, without_checksum(frame))

    def _is_dropped(self, come_from: int, size: int) -> bool:
        if self._is_unplugged(come_from):
            self.counts["unplugged"] += 1
            return True
        if self._random.random() < self._loss:
            self.counts["lost"] += 1
            return True
        return self._take_time(self._free_at[come_from], 0, size) is None

    def _queue(self, come_from: int, to: int, frame: bytes) -> None:
        if self._is_unplugged(to):
            self.counts["unplugged"] += 1
            return
        at = self._take_time(self._free_at[to], 1, len(frame), self._free_at[come_from][0])
        if at is not None:
            heapq.heappush(self._waiting, (at, to, frame))

    def _take_time(self, free_at: list[float], direction: int, size: int, earliest: float = 0.0) -> float | None:
        """When a frame has gone through a cable, s; None where too much waits."""
        begin = max(time.monotonic(), earliest, free_at[direction])
        if 0.125 * (free_at[direction] - time.monotonic()) * self._rate > QUEUE:
            self.counts["queue full"] += 1
            return None
        free_at[direction] = begin + 8.0 * size / self._rate
        return free_at[direction]

    def _is_unplugged(self, number: int) -> bool:
        return time.monotonic() < self._unplugged.get(self._hosts[number].name, 0.0)


def without_checksum(frame: bytes) -> bytes:
    """A frame in which UDP's checksum is zero, which means none, in IPv4.

    The kernel leaves it to the network card, and there is none.
    """
    is_udp = frame[12:14] == b"\x08\x00" and frame[23] == 17
    if not is_udp or int.from_bytes(frame[20:22], "big") & 0x1FFF:  # later fragments have no head
        return frame
    at = 14 + 4 * (frame[14] & 15) + 6
    return frame[:at] + b"\0\0" + frame[at + 2 :]

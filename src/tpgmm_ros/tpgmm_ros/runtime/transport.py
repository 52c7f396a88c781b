# SPDX-License-Identifier: Apache-2.0
"""How Fast DDS carries messages between processes of one machine: by the network's loopback, not by shared memory.

Fast DDS's shared memory has locks in it. A process that is killed while it holds one (SIGKILL, out of memory, a
crash) never gives it back, and every other process that writes to the same port waits for it for ever, with all of its
topics: the controller of a robot stops since a viewer has died. Seen by `make stress`, with Fast DDS 2.14.5: the main
thread waits for a lock of its participant, which a thread holds that waits in `SharedMemManager::Port` for the lock of
a process that is no more. Upstream says that a process that does not end properly can corrupt the memory of others
(eProsima/Fast-DDS, issue 1144). Messages of control are small: the loopback takes about as long.
"""

from __future__ import annotations

import os
from pathlib import Path

from tpgmm_ros.runtime.resources import installed_config_file

#: Whoever has set one of them has chosen.
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
RANGE, LOCALHOST_ONLY = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"


def avoid_shared_memory() -> None:
    """Set the environment of this process and its children so, unless it says which transports are to be used.

    Where only nodes of this machine are to be found (`LOCALHOST`), rmw_fastrtps chooses the transports itself, and
    shared memory is one of them. The range is that of the loopback interface then, which is the same, and no other
    machine can reach the sockets either.
    """
    environment = os.environ
    if not environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
        return
    profile = installed_config_file("security/this_machine.xml")
    chosen = [environment[name] for name in (TRANSPORTS, *PROFILES) if environment.get(name)]
    if any(item != str(profile) for item in chosen):
        return
    if environment.get(RANGE) == "LOCALHOST" or environment.get(LOCALHOST_ONLY) == "1":
        if profile.exists():
            environment.pop(LOCALHOST_ONLY, None)
            environment[RANGE] = "SUBNET"
            environment[PROFILES[0]] = str(profile)
    elif not chosen:
        environment[TRANSPORTS] = "UDPv4"


def uses_shared_memory(pid: int) -> bool:
    """Whether a process of this machine has shared memory of Fast DDS open (Linux)."""
    return "/dev/shm/fastrtps_" in Path(f"/proc/{pid}/maps").read_text()

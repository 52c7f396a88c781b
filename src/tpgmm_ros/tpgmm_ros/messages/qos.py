# SPDX-License-Identifier: Apache-2.0
"""One quality of service per kind of topic."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

#: Streams (references, joint states, torques, poses): only the newest counts, and a late one is worth nothing.
STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

#: Joint states: a state may come in several messages at once, with those of others between. Whoever subscribes takes
#: all that wait and answers the newest state, so that a queue costs no time.
STATES = QoSProfile(depth=16, reliability=ReliabilityPolicy.BEST_EFFORT)

#: Streams to programs of others, which may insist on reliable ones, as ros2_control's controllers do.
COMMANDS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)

#: State that a node which starts later must get too (task parameters, controller state).
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

#: Topics with news of several things, as transforms, or forces at several links: all count, not the newest alone.
MIXED = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)

#: Transforms for others: their listeners insist on reliable ones.
BROADCAST = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

#: Transforms that never change come once, also to those who listen later.
TRANSFORMS_STATIC = QoSProfile(
    depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

#: Everything counts and nobody waits for it (diagnostics, the simulation's clock).
EVENTS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

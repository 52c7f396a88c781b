# SPDX-License-Identifier: Apache-2.0
"""Who a node's topics are shared with: others that cannot be heard or cannot hear, and topics with two writers."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tpgmm_core.common.text import one_line
from tpgmm_ros.messages.classes import type_name

#: Topics that every node writes to, or anyone may; joints may have several drivers, and transforms several sources.
SHARED = ("/diagnostics", "/rosout", "/parameter_events", "/external_wrench", "/joint_states", "/tf", "/tf_static")


def graph_problems(node: Node) -> list[str]:
    """What is wrong with the topics of a node at present, in words: which topic, which other node, what to set.

    Nothing of it raises an error by itself: messages of incompatible quality of service just do not come, and of two
    that write to one topic, each command is followed by one of the other.

    Parameters
    ----------
    node
        whose topics are looked at

    Returns
    -------
    list[str]
        one sentence for each problem
    """
    found = []
    written = {publisher.topic_name for publisher in node.publishers}
    heard = {subscription.topic_name for subscription in node.subscriptions}
    for topic in sorted(written | heard):
        writers = node.get_publishers_info_by_topic(topic)
        if len(writers) > 1 and not topic.endswith(SHARED):
            found.append(f"{len(writers)} publishers on {topic}, {_names(writers)}: expected one; end the others")
        for own in (item.qos_profile for item in node.publishers if item.topic_name == topic):
            for info in node.get_subscriptions_info_by_topic(topic):
                if misfits := _misfits(own, info.qos_profile):
                    found.append(f"{_name(info)} cannot hear {topic}: {_advice(misfits, own)}")
        for item in (item for item in node.subscriptions if item.topic_name == topic):
            own, kind = item.qos_profile, type_name(item.msg_type)
            for info in writers:
                if info.topic_type != kind:
                    what = one_line(info.topic_type, 120)
                    found.append(f"{_name(info)} is not heard on {topic}: it publishes {what}, expected {kind}")
                elif misfits := _misfits(info.qos_profile, own):
                    found.append(f"{_name(info)} is not heard on {topic}: {_advice(misfits, own)}")
    return found


def _misfits(offered: QoSProfile, requested: QoSProfile) -> list[str]:
    """The policies by which less is offered than requested. Nobody here sets deadlines or liveliness."""
    reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
    misfits = []
    if requested.reliability == reliable != offered.reliability:
        misfits.append("reliability")
    if requested.durability == latched != offered.durability:
        misfits.append("durability")
    return misfits


def _advice(misfits: Iterable[str], own: QoSProfile) -> str:
    """What the other side has to set to fit to this node's profile."""
    return "set " + " and ".join(f"{name} {getattr(own, name).name.lower()}" for name in misfits) + " there"


def _name(info: TopicEndpointInfo) -> str:
    return one_line(f"{info.node_namespace.rstrip('/')}/{info.node_name}", 120)


def _names(infos: Iterable[TopicEndpointInfo]) -> str:
    names = sorted(_name(info) for info in infos)
    return " and ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")

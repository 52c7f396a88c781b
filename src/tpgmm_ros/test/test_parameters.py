# SPDX-License-Identifier: Apache-2.0
"""Node parameters: described, with a range, refused as a whole with the reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tpgmm_core.common.old_names import RENAMED_PARAMETERS
from tpgmm_core.retrieval.outcome import ExecutionConfig
from tpgmm_ros.runtime.parameters import Declared, Parameters, declared_of

DECLARED = [
    Declared("low", 1.0, "Lower end, m", 0.0, 10.0),
    Declared("high", 2.0, "Upper end, m", 0.0, 10.0),
    Declared("count", 3, "How many", 1, 5),
    Declared("file", "a", "Read at start", fixed=True),
]


def in_order(values: Mapping[str, Any]) -> None:
    if values["low"] > values["high"]:
        raise ValueError(f"low {values['low']} is above high {values['high']}")


def change(node: Node, **values: object) -> SetParametersResult:
    return node.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])


@pytest.fixture
def parameters(ros_node: Node) -> Parameters:
    return Parameters(ros_node, DECLARED, check=in_order)


def test_defaults_descriptions_and_ranges_are_there_for_tools(ros_node: Node, parameters: Parameters) -> None:
    assert [parameters[item.name] for item in DECLARED] == [1.0, 2.0, 3, "a"]
    descriptor = ros_node.describe_parameter("high")
    assert descriptor.description == "Upper end, m"
    assert descriptor.floating_point_range[0].to_value == 10.0
    assert ros_node.describe_parameter("count").integer_range[0].to_value == 5
    assert ros_node.describe_parameter("file").read_only


def test_a_name_of_an_earlier_version_is_refused_with_the_present_one(ros_node: Node) -> None:
    for old, new in RENAMED_PARAMETERS.items():
        node = rclpy.create_node("old_names", context=ros_node.context, parameter_overrides=[Parameter(old, value=0.5)])
        try:
            with pytest.raises(ValueError, match=f"the parameter {old} is called {new} now"):
                Parameters(node, [Declared(new, 1.0, "A share", 0.0, 1.0)])
            assert Parameters(node, DECLARED)["low"] == 1.0, "it may be the name of something else in another node"
        finally:
            node.destroy_node()


def test_good_values_are_taken(ros_node: Node, parameters: Parameters) -> None:
    assert change(ros_node, low=3.0, high=4.0).successful
    assert (parameters["low"], parameters["high"]) == (3.0, 4.0)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"low": 0.5, "high": 11.0}, "high"),
        ({"low": 0.5, "count": 0}, "count"),
        ({"high": 0.5}, "low 1.0 is above high 0.5"),
        ({"low": 0.5, "file": "b"}, "file"),
        ({"low": 0.5, "high": "wide"}, "expected 'Type.DOUBLE'"),
    ],
)
def test_a_bad_value_refuses_the_whole_change_with_the_reason(
    ros_node: Node, parameters: Parameters, values: dict[str, object], reason: str
) -> None:
    result = change(ros_node, **values)
    assert not result.successful and reason in result.reason
    assert [parameters[item.name] for item in DECLARED] == [1.0, 2.0, 3, "a"]


def test_bad_values_at_start_are_refused(ros_node: Node) -> None:
    with pytest.raises(InvalidParameterValueException):
        Parameters(ros_node, [Declared("speed", 20.0, "m/s", 0.0, 10.0)])
    with pytest.raises(ValueError, match="above"):
        Parameters(ros_node, [Declared("low", 3.0, ""), Declared("high", 2.0, "")], check=in_order)


def test_the_settings_of_a_dataclass_become_parameters_and_fill_it_again(ros_node: Node) -> None:
    parameters = Parameters(ros_node, declared_of(ExecutionConfig))
    assert parameters.fill(ExecutionConfig) == ExecutionConfig()
    assert change(ros_node, settle_time=2.5).successful
    assert parameters.fill(ExecutionConfig).settle_time == 2.5
    assert not change(ros_node, settle_time=-1.0).successful
    assert ros_node.describe_parameter("settle_time").description


def test_a_name_that_is_nearly_a_parameter_is_said_and_names_of_other_nodes_are_not(
    ros_node: Node, capfd: pytest.CaptureFixture[str]
) -> None:
    given = [Parameter(name, value=3.0) for name in ("robot_file", "joint_state_rate", "low")]
    node = rclpy.create_node("misspelt", context=ros_node.context, parameter_overrides=given)
    try:
        Parameters(node, [Declared("high_speed", 1.0, "m/s"), *DECLARED, Declared("joint_state_rates", 1.0, "Hz")])
    finally:
        node.destroy_node()
    said = capfd.readouterr().err
    assert "there is no parameter 'joint_state_rate', it has no effect: is joint_state_rates meant?" in said
    assert said.count("it has no effect") == 1

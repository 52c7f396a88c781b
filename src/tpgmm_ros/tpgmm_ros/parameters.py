# SPDX-License-Identifier: Apache-2.0
"""Node parameters with a description and a range; a bad value is refused as a whole, with the reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter


@dataclass(frozen=True, slots=True)
class Declared:
    """One parameter.

    default: its type is the parameter's type.
    lower, upper: inclusive bounds of a number.
    fixed: read at start only; a change while running is refused.
    """

    name: str
    default: bool | int | float | str
    description: str
    lower: float | None = None
    upper: float | None = None
    fixed: bool = False

    def descriptor(self) -> ParameterDescriptor:
        descriptor = ParameterDescriptor(name=self.name, description=self.description, read_only=self.fixed)
        if self.lower is not None and self.upper is not None:
            if isinstance(self.default, int):
                descriptor.integer_range = [
                    IntegerRange(from_value=int(self.lower), to_value=int(self.upper), step=0)
                ]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=self.lower, to_value=self.upper, step=0.0)
                ]
        return descriptor


def declare(node: Node, declared: Sequence[Declared]) -> dict[str, Any]:
    """Declare parameters and return their values by name.

    Raises:
        rclpy.exceptions.InvalidParameterValueException: a value given at start is out of its range.
    """
    for item in declared:
        node.declare_parameter(item.name, item.default, item.descriptor())
    return {item.name: node.get_parameter(item.name).value for item in declared}


def on_change(node: Node, apply: Callable[[dict[str, Any]], None]) -> None:
    """Call ``apply(changes)`` when parameters are set; a ``ValueError`` from it refuses the whole set."""

    def callback(parameters: list[Parameter]) -> SetParametersResult:
        try:
            apply({parameter.name: parameter.value for parameter in parameters})
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(callback)

# SPDX-License-Identifier: Apache-2.0
"""Node parameters with a description and a range; a bad value is refused as a whole, with the reason."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from tpgmm_core.common.old_names import RENAMED_PARAMETERS
from tpgmm_core.common.settings import setting_of
from tpgmm_core.common.text import one_line, shown
from tpgmm_ros.runtime.rclpy_workarounds import parameter_overrides

#: A name that is so like a parameter's was meant to be that; files for several nodes hold other names too.
ALIKE = 0.85


@dataclass(frozen=True, slots=True)
class Declared:
    """One parameter.

    Parameters
    ----------
    default
        its type is the parameter's type
    lower, upper
        inclusive bounds of a number
    fixed
        read at start only; a change while running is refused
    any_type
        a value of another type is no error of ROS; who reads it takes what he understands
    """

    name: str
    default: bool | int | float | str | list[str]
    description: str
    lower: float | None = None
    upper: float | None = None
    fixed: bool = False
    any_type: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """What ROS is told of it: description, range, and whether it may change."""
        descriptor = ParameterDescriptor(name=self.name, description=self.description, read_only=self.fixed)
        descriptor.dynamic_typing = self.any_type
        if self.lower is not None and self.upper is not None:
            if isinstance(self.default, int):
                descriptor.integer_range = [IntegerRange(from_value=int(self.lower), to_value=int(self.upper), step=0)]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=self.lower, to_value=self.upper, step=0.0)
                ]
        return descriptor

    def help(self) -> str:
        """Meaning, default and range in a line."""
        known = f"default {self.default!r}"
        if self.lower is not None and self.upper is not None:
            known += f", {self.lower:g} to {self.upper:g}"
        return f"{self.description} ({known}{', fixed' if self.fixed else ''})"


def declared_of(config: type) -> list[Declared]:
    """One parameter for each setting of a dataclass (see ``tpgmm_core.common.settings``)."""
    return [
        Declared(item.name, known.default, known.description, known.lower, known.upper)
        for item, known in ((item, setting_of(item)) for item in fields(config))
    ]


def fill[ConfigT](config: type[ConfigT], values: Mapping[str, Any]) -> ConfigT:
    """A dataclass from the values of its fields' names.

    Parameters
    ----------
    config
        the dataclass
    values
        by name; others may be among them

    Returns
    -------
    ConfigT
        an object of that class

    Raises
    ------
    ValueError
        from the dataclass
    """
    return config(**{item.name: values[item.name] for item in fields(config)})  # type: ignore[arg-type]


class Parameters:
    """The declared parameters of a node and their present values, ``parameters["name"]``.

    Parameters
    ----------
    node
        the node
    declared
        what it takes
    check
        called with all values as they would be after a change; a ``ValueError`` from it refuses the whole set of
        changes, with its text as the reason
    changed
        called after values have changed

    Raises
    ------
    rclpy.exceptions.InvalidParameterValueException
        a value given at start is out of its range.
    ValueError
        from ``check``, for the values given at start; or one of these has a name of an earlier version.
    """

    def __init__(
        self,
        node: Node,
        declared: Sequence[Declared],
        check: Callable[[Mapping[str, Any]], object] | None = None,
        changed: Callable[[], None] | None = None,
    ) -> None:
        declared_names = {item.name for item in declared}
        for old in parameter_overrides(node) & RENAMED_PARAMETERS.keys():
            if (new := RENAMED_PARAMETERS[old]) in declared_names:
                raise ValueError(f"the parameter {old} is called {new} now: give that one instead")
        for name in sorted(parameter_overrides(node) - declared_names):
            for meant in get_close_matches(name, declared_names, 1, ALIKE):
                node.get_logger().warning(f"there is no parameter {shown(name)}, it has no effect: is {meant} meant?")
        for item in declared:
            node.declare_parameter(item.name, item.default, item.descriptor())
        self._values: dict[str, Any] = {item.name: node.get_parameter(item.name).value for item in declared}
        self._check = check
        self._changed = changed
        if check is not None:
            check(self._values)
        node.add_on_set_parameters_callback(self._refuse)
        node.add_post_set_parameters_callback(self._take)

    def file(self, name: str) -> str:
        """The value of a parameter that names a file.

        Parameters
        ----------
        name
            of the parameter

        Returns
        -------
        str
            the path

        Raises
        ------
        ValueError
            where it is not set
        """
        files = self.files(name)
        if not files:
            raise ValueError(f"the parameter {name} is not set: give it the path of a file (-p {name}:=PATH)")
        return files[0]

    def files(self, name: str) -> list[str]:
        """Paths that a parameter names, one or a list of them; shells leave ~ as it is behind := ."""
        value = self[name]
        files = value if isinstance(value, list | tuple) else [value]
        return [os.path.expanduser(str(file)) for file in files if file]

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def fill[ConfigT](self, config: type[ConfigT]) -> ConfigT:
        """A dataclass whose fields are parameters of the same names.

        Parameters
        ----------
        config
            the dataclass

        Returns
        -------
        ConfigT
            an object of that class

        Raises
        ------
        ValueError
            from the dataclass
        """
        return fill(config, self._values)

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        changed = {**self._values, **{item.name: item.value for item in parameters if item.name in self._values}}
        try:
            if self._check is not None:
                self._check(changed)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=one_line(error))
        return SetParametersResult(successful=True)

    def _take(self, parameters: list[Parameter]) -> None:
        for item in parameters:
            if item.name in self._values:
                self._values[item.name] = item.value
        if self._changed is not None:
            self._changed()

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The options of ``options.py`` as parameters of a node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from trajectory_calibration.config.settings import Option
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.options import (
    check_foreign,
    check_values,
    FIXED_NAMES,
    is_foreign,
    OPTIONS,
)


class NodeParameters:
    """The parameters of a node, declared and kept valid.

    ``node`` must have been made with ``automatically_declare_parameters_from_overrides``: that is
    how a misspelt name in a parameter file becomes an error instead of being ignored.

    Raises
    ------
    ConfigError
        A parameter given at the start is unknown or invalid.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        given = {}
        for name, parameter in node.get_parameters_by_prefix('').items():
            check_foreign(name, parameter.value)
            if not is_foreign(name):
                given[name] = parameter.value
        values = check_values(given)
        for name in given:
            node.undeclare_parameter(name)
        for name, option in OPTIONS.items():
            node.declare_parameter(
                name, values[name], _descriptor(option), ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)

    def __getitem__(self, name: str) -> Any:
        return OPTIONS[name].check(self._node.get_parameter(name).value)

    def values(self) -> dict[str, Any]:
        """Return all values as they are now, each in its type."""
        return {name: self[name] for name in OPTIONS}

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters
                   if not is_foreign(parameter.name)}
        try:
            check_values({**self.values(), **changes})
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _descriptor(option: Option) -> ParameterDescriptor:
    """Describe an option to ROS tools; typed dynamically, so that 1 serves where 1.0 is meant."""
    descriptor = ParameterDescriptor(
        description=option.help, read_only=option.name in FIXED_NAMES, dynamic_typing=True,
        additional_constraints=f'one of {", ".join(option.choices)}' if option.choices else '')
    if option.minimum is not None and option.maximum is not None:
        if option.kind is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=option.minimum, to_value=option.maximum)]
        elif option.kind is int:
            descriptor.integer_range = [
                IntegerRange(from_value=int(option.minimum), to_value=int(option.maximum))]
    return descriptor

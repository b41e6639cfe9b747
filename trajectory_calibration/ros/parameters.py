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
    check_values,
    FIXED_NAMES,
    OPTIONS,
)


class NodeParameters:
    """Declares and validates the parameters of a node.

    ``node`` must be created with ``automatically_declare_parameters_from_overrides``, so that a
    misspelt name in a parameter file is an error and not ignored.

    Raises
    ------
    ConfigError
        A parameter given at the start is unknown or invalid.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        given = {name: parameter.value
                 for name, parameter in node.get_parameters_by_prefix('').items()}
        values = check_values(given)
        for name, option in OPTIONS.items():
            if name in given:
                node.undeclare_parameter(name)
            node.declare_parameter(
                name, values[name], _descriptor(option), ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)

    def values(self) -> dict[str, Any]:
        """Return all current values, each in its type."""
        return {name: option.check(self._node.get_parameter(name).value)
                for name, option in OPTIONS.items()}

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            check_values({
                **self.values(), **{parameter.name: parameter.value for parameter in parameters}})
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _descriptor(option: Option) -> ParameterDescriptor:
    """Return the descriptor of an option; with dynamic typing, so that 1 is valid for 1.0."""
    descriptor = ParameterDescriptor(
        description=option.help, read_only=option.name in FIXED_NAMES, dynamic_typing=True,
        additional_constraints=f'one of {", ".join(option.choices)}' if option.choices else '')
    limits = {'from_value': option.minimum, 'to_value': option.maximum}
    if option.kind is float:
        descriptor.floating_point_range = [FloatingPointRange(**limits)]
    elif option.kind is int:
        descriptor.integer_range = [IntegerRange(**limits)]
    return descriptor

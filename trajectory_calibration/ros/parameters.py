"""The node's parameters: one for each field of CalibrationConfig, and the node's own.

Defaults, ranges and words come from ``CalibrationConfig.options()`` and ``NODE_OPTIONS``; a value
is judged by ``Option.check`` alone, at the start and at run time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from trajectory_calibration.config import CalibrationConfig, Option
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.ros.buffer import BufferLimits
from trajectory_calibration.ros.conversions import AUTOMATIC, find_reader, READERS

_LIMITS = BufferLimits()
_TYPES = f'{AUTOMATIC} (what the publishers offer), {", ".join(READERS)}'

# Read once at the start.
FIXED_OPTIONS = (
    Option('topic_a', str, 'trajectory_a', 'topic with the trajectory of the parent sensor a'),
    Option('topic_b', str, 'trajectory_b', 'topic with the trajectory of the child sensor b'),
    Option('type_a', str, AUTOMATIC, f'message type of topic_a: {_TYPES}'),
    Option('type_b', str, AUTOMATIC, f'message type of topic_b: {_TYPES}'),
    Option('queue_depth', int, 5000, 'messages that wait on each topic while the node is busy',
           minimum=1, maximum=1_000_000),
    Option('max_poses', int, _LIMITS.max_poses, 'poses kept of each sensor, the newest',
           minimum=10, maximum=10_000_000),
    Option('max_age', float, _LIMITS.max_age_s, 'age up to which poses are kept, seconds',
           minimum=1.0, maximum=1e7),
    Option('still_after', float, _LIMITS.still_after_s, 'time without motion after which only '
           'the newest pose of a standstill is kept, seconds', minimum=0.0, maximum=1e7),
    Option('still_distance', float, _LIMITS.still_distance,
           'distance below which a sensor has not moved, metres; 0 keeps every pose',
           minimum=0.0, maximum=1000.0),
    Option('still_angle', float, _LIMITS.still_angle_deg,
           'angle below which a sensor has not moved, degrees', minimum=0.0, maximum=180.0),
)
# Read at each calibration.
CHANGEABLE_OPTIONS = (
    Option('frame_a', str, '', 'name of the frame of sensor a; empty: from the messages'),
    Option('frame_b', str, '', 'name of the frame of sensor b; empty: from the messages'),
    Option('calibration_timeout', float, 120.0,
           'time after which a calibration is given up, seconds', minimum=0.1, maximum=86400.0),
)
NODE_OPTIONS = FIXED_OPTIONS + CHANGEABLE_OPTIONS

_CONFIG_OPTIONS = tuple(CalibrationConfig.options())
_OPTIONS = {option.name: option for option in (*NODE_OPTIONS, *_CONFIG_OPTIONS)}
_FIXED = frozenset(option.name for option in FIXED_OPTIONS)
# What rclpy itself declares on every node.
_FOREIGN_PREFIXES = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')


def check_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return every parameter in its type, the defaults where ``values`` has none.

    Raises
    ------
    ConfigError
        An unknown name, or a value that does not fit, alone or with the others.

    """
    unknown = sorted(name for name in values if name not in _OPTIONS)
    if unknown:
        raise ConfigError(
            f'parameter {unknown[0]!r} is unknown; known are {", ".join(sorted(_OPTIONS))}')
    checked = {name: option.check(values.get(name, option.default))
               for name, option in _OPTIONS.items()}
    find_reader(checked['type_a'])
    find_reader(checked['type_b'])
    CalibrationConfig(**{option.name: checked[option.name] for option in _CONFIG_OPTIONS})
    return checked


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
        given = {
            name: parameter.value for name, parameter in node.get_parameters_by_prefix('').items()
            if not name.startswith(_FOREIGN_PREFIXES)}
        values = check_values(given)
        for name in given:
            node.undeclare_parameter(name)
        for name, option in _OPTIONS.items():
            node.declare_parameter(
                name, values[name], _descriptor(option), ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)

    def __getitem__(self, name: str) -> Any:
        return _OPTIONS[name].check(self._node.get_parameter(name).value)

    def config(self) -> CalibrationConfig:
        """Return the settings of a calibration started now."""
        return CalibrationConfig(**{option.name: self[option.name] for option in _CONFIG_OPTIONS})

    def limits(self) -> BufferLimits:
        """Return how much the buffers keep."""
        return BufferLimits(
            self['max_poses'], self['max_age'], self['still_after'], self['still_distance'],
            self['still_angle'])

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters
                   if not parameter.name.startswith(_FOREIGN_PREFIXES)}
        try:
            check_values({**{name: self[name] for name in _OPTIONS}, **changes})
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)


def _descriptor(option: Option) -> ParameterDescriptor:
    """Describe an option to ROS tools; typed dynamically, so that 1 serves where 1.0 is meant."""
    descriptor = ParameterDescriptor(
        description=option.help, read_only=option.name in _FIXED, dynamic_typing=True,
        additional_constraints=f'one of {", ".join(option.choices)}' if option.choices else '')
    if option.minimum is not None and option.maximum is not None:
        if option.kind is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=option.minimum, to_value=option.maximum)]
        elif option.kind is int:
            descriptor.integer_range = [
                IntegerRange(from_value=int(option.minimum), to_value=int(option.maximum))]
    return descriptor

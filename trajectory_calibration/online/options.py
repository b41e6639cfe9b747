"""The node's options: one for each field of CalibrationConfig, and the node's own.

Defaults, ranges and words of the parameters, of ``config/calibration.yaml`` and of a replay come
from here; a value is judged by ``Option.check`` alone, at the start and at run time. Nothing
here imports ROS.

``python3 -m trajectory_calibration.online.options > config/calibration.yaml`` writes the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import sys
import textwrap
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig, Option
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.online.buffer import BufferLimits
from trajectory_calibration.sources.cdr import TRAJECTORY_TYPES

# What rclpy itself declares on every node, and how the names begin that it may declare.
_FOREIGN_NAMES = ('use_sim_time', 'start_type_description_service')
_FOREIGN_PREFIX = 'qos_overrides.'

# The type that means: what the topic's publishers offer.
AUTOMATIC = 'auto'

_LIMITS = BufferLimits()
_TYPES = f'{AUTOMATIC} (what the publishers offer), {", ".join(TRAJECTORY_TYPES)}'

TOPIC_OPTIONS = (
    Option('topic_a', str, 'trajectory_a', 'topic with the trajectory of the parent sensor a'),
    Option('topic_b', str, 'trajectory_b', 'topic with the trajectory of the child sensor b'),
    Option('type_a', str, AUTOMATIC, f'message type of topic_a: {_TYPES}'),
    Option('type_b', str, AUTOMATIC, f'message type of topic_b: {_TYPES}'),
    Option('queue_depth', int, 5000, 'poses that wait on each topic while the node is busy; of '
           'Paths only the newest does', minimum=1, maximum=1_000_000),
)
BUFFER_OPTIONS = (
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
FRAME_OPTIONS = (
    Option('frame_a', str, '', 'name of the frame of sensor a; empty: from the messages'),
    Option('frame_b', str, '', 'name of the frame of sensor b; empty: from the messages'),
)
RESULT_OPTIONS = (
    Option('result_directory', str, '',
           'folder in which every result is saved; empty: none is'),
    Option('restore', bool, default=False,
           help='publish the newest result in result_directory when the node starts'),
)
ANSWER_OPTIONS = (
    Option('calibration_timeout', float, 120.0,
           'time after which a calibration is given up, seconds', minimum=0.1, maximum=86400.0),
)
OUTPUT_OPTIONS = (
    Option('publish_tf', bool, default=False,
           help='publish the extrinsic on /tf_static too; needs tf2_msgs'),
)
ADVICE_OPTIONS = (
    Option('target_translation_std', float, 0.02,
           'standard deviation of the translation that is wanted, metres',
           minimum=1e-6, maximum=1000.0),
    Option('target_rotation_std', float, 0.2,
           'standard deviation of the rotation that is wanted, degrees',
           minimum=1e-6, maximum=180.0),
    Option('auto_calibrate', bool, default=False,
           help='calibrate once when the motion so far promises both'),
)
CONFIG_OPTIONS = tuple(CalibrationConfig.options())

# Title, options, whether a running node takes a new value.
_GROUPS: tuple[tuple[str, tuple[Option, ...], bool], ...] = (
    ('Inputs', TOPIC_OPTIONS, False),
    ('What is kept', BUFFER_OPTIONS, False),
    ('Saved results', RESULT_OPTIONS, False),
    ('What is published', OUTPUT_OPTIONS, False),
    ('Names of the sensors', FRAME_OPTIONS, True),
    ('The answer', ANSWER_OPTIONS, True),
    ('When the motion is enough', ADVICE_OPTIONS, True),
    ('The calibration', CONFIG_OPTIONS, True),
)
OPTIONS = {option.name: option for _, options, _ in _GROUPS for option in options}
FIXED_NAMES = frozenset(
    option.name for _, options, changeable in _GROUPS if not changeable for option in options)


def is_foreign(name: str) -> bool:
    """Tell whether a parameter is not the node's own, but what rclpy declares on every node."""
    return name in _FOREIGN_NAMES or name.startswith(_FOREIGN_PREFIX)


def check_foreign(name: str, value: Any) -> None:
    """Raise ConfigError for a value of rclpy's own switches that is none: it would go unheeded."""
    if name in _FOREIGN_NAMES and not isinstance(value, bool):
        raise ConfigError(f'{name} is {value!r}, needed true or false')


def check_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return every option in its type, the defaults where ``values`` has none.

    Raises
    ------
    ConfigError
        An unknown name, or a value that does not fit, alone or with the others.

    """
    unknown = sorted(name for name in values if name not in OPTIONS)
    if unknown:
        raise ConfigError(
            f'parameter {unknown[0]!r} is unknown; known are {", ".join(sorted(OPTIONS))}')
    checked = {name: option.check(values.get(name, option.default))
               for name, option in OPTIONS.items()}
    find_type(checked['type_a'])
    find_type(checked['type_b'])
    to_config(checked)
    if checked['restore'] and not checked['result_directory']:
        raise ConfigError('restore needs result_directory: the folder with the saved results')
    return checked


def to_config(values: Mapping[str, Any]) -> CalibrationConfig:
    """Return the settings of a calibration among checked values."""
    return CalibrationConfig(**{option.name: values[option.name] for option in CONFIG_OPTIONS})


def to_limits(values: Mapping[str, Any]) -> BufferLimits:
    """Return how much the buffers keep according to checked values."""
    return BufferLimits(
        values['max_poses'], values['max_age'], values['still_after'], values['still_distance'],
        values['still_angle'])


def find_type(name: str) -> str | None:
    """Return 'nav_msgs/msg/Odometry' of itself or for short of 'Odometry'; None of 'auto'.

    Raises
    ------
    ConfigError
        A type that cannot serve as a trajectory; the message lists those that can.

    """
    if name == AUTOMATIC:
        return None
    for msgtype in TRAJECTORY_TYPES:
        if name in (msgtype, msgtype.replace('/msg/', '/'), msgtype.rpartition('/')[2]):
            return msgtype
    raise ConfigError(
        f'type {name!r} cannot serve as a trajectory; needed one of {AUTOMATIC}, '
        f'{", ".join(TRAJECTORY_TYPES)}')


def parameter_file() -> str:
    """Return the parameter file with every option, its default and its explanation."""
    lines = [
        '# Every parameter of calibration_node with its default. Copy, change, and start with',
        '#   ros2 run trajectory_calibration calibration_node --ros-args --params-file FILE',
        '/**:',
        '  ros__parameters:']
    for title, options, changeable in _GROUPS:
        when = 'may be changed while the node runs' if changeable else 'read once at the start'
        lines += ['', f'    # --- {title}; {when} ---']
        for option in options:
            lines += _commented(option)
    return '\n'.join(lines) + '\n'


def _commented(option: Option) -> Iterable[str]:
    text = option.help[0].upper() + option.help[1:]
    if option.choices:
        text += f': {", ".join(option.choices)}'
    elif option.minimum is not None and option.maximum is not None:
        text += f' ({option.minimum:.10g} to {option.maximum:.10g})'
    yield from textwrap.wrap(
        f'{text}.', 92, initial_indent='    # ', subsequent_indent='    # ')
    default = repr(option.default)
    yield f'    {option.name}: {default.lower() if option.kind is bool else default}'


if __name__ == '__main__':
    sys.stdout.write(parameter_file())

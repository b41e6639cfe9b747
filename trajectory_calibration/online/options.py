# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The node's options: one for each field of CalibrationConfig, and the node's own.

Defaults, ranges and words of the parameters, of ``config/calibration.yaml`` and of a replay come
from here; a value is judged by ``Option.check`` alone, at the start and at run time.

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
from trajectory_calibration.sources.transforms import parse_tf, TF_PREFIX

# What rclpy itself declares on every node, and how the names begin that it may declare.
_FOREIGN_NAMES = ('use_sim_time', 'start_type_description_service')
_FOREIGN_PREFIX = 'qos_overrides.'

# The type that means: what the topic's publishers offer.
AUTOMATIC = 'auto'

_LIMITS = BufferLimits()
_TYPES = f'{AUTOMATIC} (what its publishers offer), {", ".join(TRAJECTORY_TYPES)}'
_TF = f'or two frames of /tf as {TF_PREFIX}PARENT.CHILD'

TOPIC_OPTIONS = (
    Option('topic_a', str, 'trajectory_a',
           f'topic with the trajectory of the parent sensor a, {_TF}'),
    Option('topic_b', str, 'trajectory_b',
           f'topic with the trajectory of the child sensor b, {_TF}'),
    Option('type_a', str, AUTOMATIC, f'message type of topic_a: {_TYPES}'),
    Option('type_b', str, AUTOMATIC, f'message type of topic_b: {_TYPES}'),
    Option('queue_depth', int, 5000, 'depth of the subscription queues (a Path topic always '
           'uses 1)', minimum=1, maximum=1_000_000),
)
BUFFER_OPTIONS = (
    Option('max_poses', int, _LIMITS.max_poses,
           'largest number of poses kept for each sensor; the oldest are dropped first',
           minimum=10, maximum=10_000_000),
    Option('max_age', float, _LIMITS.max_age_s, 'largest age of the poses that are kept, seconds',
           minimum=1.0, maximum=1e7),
    Option('still_after', float, _LIMITS.still_after_s, 'time without motion after which only '
           'the newest pose of a standstill is kept, seconds', minimum=0.0, maximum=1e7),
    Option('still_distance', float, _LIMITS.still_distance,
           'motion below this distance counts as standing still, metres; 0 keeps every pose',
           minimum=0.0, maximum=1000.0),
    Option('still_angle', float, _LIMITS.still_angle_deg,
           'motion below this angle counts as standing still, degrees', minimum=0.0,
           maximum=180.0),
)
FRAME_OPTIONS = (
    Option('frame_a', str, '', 'frame of sensor a; empty: as the messages name it'),
    Option('frame_b', str, '', 'frame of sensor b; empty: as the messages name it'),
)
RESULT_OPTIONS = (
    Option('result_directory', str, '',
           'folder in which every result is saved; empty: results are not saved'),
    Option('restore', bool, default=False,
           help='publish the newest result in result_directory after a start, once frame_a and '
           'frame_b or the frames that arrive match it'),
)
ANSWER_OPTIONS = (
    Option('calibration_timeout', float, 120.0,
           'time after which a calibration is stopped, seconds', minimum=0.1, maximum=86400.0),
)
OUTPUT_OPTIONS = (
    Option('publish_tf', bool, default=False,
           help='publish the extrinsic on /tf_static too, where it does not give a frame a '
           'second parent; needs tf2_msgs'),
    Option('diagnostic_updater.period', float, 1.0, 'time between two messages on /diagnostics, '
           'seconds', minimum=0.05, maximum=60.0),
)
ADVICE_OPTIONS = (
    Option('target_translation_std', float, 0.02,
           'wanted standard deviation of the translation, metres',
           minimum=1e-6, maximum=1000.0),
    Option('target_rotation_std', float, 0.2,
           'wanted standard deviation of the rotation, degrees',
           minimum=1e-6, maximum=180.0),
    Option('auto_calibrate', bool, default=False,
           help='calibrate once, without a call, when both are reached'),
)
MONITOR_OPTIONS = (
    Option('monitor', bool, default=False,
           help='check again and again whether the published extrinsic still holds; /diagnostics '
           'warns when it does not, and reports an error when a second check confirms it'),
    Option('monitor_period', float, 60.0, 'time between two checks, seconds', minimum=1.0,
           maximum=86400.0),
    Option('monitor_window', float, 600.0, 'each check uses the poses of this time, seconds',
           minimum=10.0, maximum=1e7),
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
    ('Whether the extrinsic still holds', MONITOR_OPTIONS, False),
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
    for side in 'ab':
        find_type(checked[f'type_{side}'])
        find_frames(checked[f'topic_{side}'])
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


def find_frames(topic: str) -> tuple[str, str] | None:
    """Return the two frames of ``tf:PARENT.CHILD``, None for a topic.

    Raises
    ------
    ConfigError
        It does not name two frames.

    """
    return parse_tf(topic) if topic.startswith(TF_PREFIX) else None


def parameter_file() -> str:
    """Return the parameter file with every option, its default and its explanation."""
    lines = [
        '# Every parameter of calibration_node with its default. Copy, edit, and start with',
        '#   ros2 run trajectory_calibration calibration_node --ros-args --params-file FILE',
        '/**:',
        '  ros__parameters:']
    for title, options, changeable in _GROUPS:
        when = 'can be changed while the node runs' if changeable else 'read once at the start'
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
    yield f'    {option.name}: {parameter_text(option.default)}'


def parameter_text(value: Any) -> str:
    """Return a value as YAML has it."""
    return repr(value).lower() if isinstance(value, bool) else repr(value)


if __name__ == '__main__':
    sys.stdout.write(parameter_file())

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The options of the node: the fields of CalibrationConfig, and those of the node itself.

They define defaults, ranges and texts of the parameters, of ``config/calibration.yaml`` and of a
replay. ``Option.check`` validates a value at the start and at run time.

``python3 -m trajectory_calibration.online.options > config/calibration.yaml`` writes the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import re
import sys
import textwrap
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig, Option
from trajectory_calibration.errors import ConfigError, unknown_name
from trajectory_calibration.online.buffer import BufferLimits
from trajectory_calibration.sources.cdr import TRAJECTORY_TYPES
from trajectory_calibration.sources.transforms import parse_tf, TF_PREFIX

# Parameters that rclpy declares on every node, and the prefix of others that it may declare.
_FOREIGN_NAMES = ('use_sim_time', 'start_type_description_service')
_FOREIGN_PREFIX = 'qos_overrides.'

# Type name for: the type of the publishers.
AUTOMATIC = 'auto'

# A command-line option with its value within a sentence.
_COMMAND_OPTION = re.compile(r'--(no-)?([a-z]+(?:-[a-z]+)*)(?:=(\S*\w))?')

_LIMITS = BufferLimits()
_TYPES = f'{AUTOMATIC} (what its publishers offer), {", ".join(TRAJECTORY_TYPES)}'
_TF = f'or two frames of /tf as {TF_PREFIX}PARENT.CHILD'

CONFIG_OPTIONS = tuple(CalibrationConfig.options())

# Title, whether the options can be changed at run time, options.
_GROUPS: tuple[tuple[str, bool, tuple[Option, ...]], ...] = (
    ('Inputs', False, (
        Option('topic_a', 'trajectory_a',
               f'topic with the trajectory of the parent sensor a, {_TF}'),
        Option('topic_b', 'trajectory_b',
               f'topic with the trajectory of the child sensor b, {_TF}'),
        Option('type_a', AUTOMATIC, f'message type of topic_a: {_TYPES}'),
        Option('type_b', AUTOMATIC, f'message type of topic_b: {_TYPES}'),
        Option('queue_depth', 5000, 'messages of a topic that may wait, which takes 0.1 s and '
               'more; of a Path always 1', 100, 1_000_000),
    )),
    ('What is kept', False, (
        Option('max_poses', _LIMITS.max_poses, 'largest number of poses kept for each sensor; the '
               'oldest are dropped first', 10, 10_000_000),
        Option('max_age', _LIMITS.max_age_s, 'largest age of the poses that are kept, seconds',
               1.0, 1e7),
        Option('still_after', _LIMITS.still_after_s, 'time without motion after which only '
               'the newest pose of a standstill is kept, seconds', 0.0, 1e7),
        Option('still_distance', _LIMITS.still_distance, 'motion below this distance counts as '
               'standing still, metres; 0 keeps every pose', 0.0, 1000.0),
        Option('still_angle', _LIMITS.still_angle_deg,
               'motion below this angle counts as standing still, degrees', 0.0, 180.0),
    )),
    ('Saved results', False, (
        Option('result_directory', '',
               'folder in which every result is saved; empty: results are not saved'),
        Option('restore', default=False, help='publish the newest result in result_directory '
               'after a start, once frame_a and frame_b or the frames that arrive match it'),
    )),
    ('What is published', False, (
        Option('publish_tf', default=False, help='publish the extrinsic on /tf_static too, where '
               'it does not give a frame a second parent; needs tf2_msgs'),
        Option('diagnostic_updater.period', 1.0,
               'time between two messages on /diagnostics, seconds', 0.05, 60.0),
    )),
    ('Names of the sensors', True, (
        Option('frame_a', '', 'frame of sensor a; empty: as the messages name it'),
        Option('frame_b', '', 'frame of sensor b; empty: as the messages name it'),
    )),
    ('The answer', True, (
        Option('calibration_timeout', 120.0, 'time after which a calibration is stopped, seconds',
               0.1, 86400.0),
    )),
    ('When the motion is enough', True, (
        Option('target_translation_std', 0.02,
               'wanted standard deviation of the translation, metres', 1e-6, 1000.0),
        Option('target_rotation_std', 0.2,
               'wanted standard deviation of the rotation, degrees', 1e-6, 180.0),
        Option('auto_calibrate', default=False,
               help='calibrate once, without a call, when both are reached'),
    )),
    ('Whether the extrinsic still holds', False, (
        Option('monitor', default=False, help='check again and again whether the published '
               'extrinsic still holds; /diagnostics warns when it does not, and reports an error '
               'when a second check confirms it'),
        Option('monitor_period', 60.0, 'time between two checks, seconds', 1.0, 86400.0),
        Option('monitor_window', 600.0, 'each check uses the poses of this time, seconds',
               10.0, 1e7),
    )),
    ('The calibration', True, CONFIG_OPTIONS),
)
OPTIONS = {option.name: option for _, _, options in _GROUPS for option in options}
FIXED_NAMES = frozenset(
    option.name for _, changeable, options in _GROUPS if not changeable for option in options)


def check_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return all options in their types, with defaults for those missing in ``values``.

    Parameters that rclpy declares on every node are left out.

    Raises
    ------
    ConfigError
        A name is unknown, or a value is invalid, alone or in combination.

    """
    for name in _FOREIGN_NAMES:
        # rclpy would ignore it.
        if not isinstance(values.get(name, False), bool):
            raise ConfigError(f'{name} is {values[name]!r}, needed true or false')
    unknown = sorted(name for name in values if name not in OPTIONS
                     and name not in _FOREIGN_NAMES and not name.startswith(_FOREIGN_PREFIX))
    if unknown:
        raise ConfigError(unknown_name('parameter', unknown[0], sorted(OPTIONS)))
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
    """Return the calibration settings of checked values."""
    return CalibrationConfig(**{option.name: values[option.name] for option in CONFIG_OPTIONS})


def to_limits(values: Mapping[str, Any]) -> BufferLimits:
    """Return the buffer limits of checked values."""
    return BufferLimits(
        values['max_poses'], values['max_age'], values['still_after'], values['still_distance'],
        values['still_angle'])


def find_type(name: str) -> str | None:
    """Return 'nav_msgs/msg/Odometry' for itself or the short 'Odometry'; None for 'auto'."""
    if name == AUTOMATIC:
        return None
    for msgtype in TRAJECTORY_TYPES:
        if name in (msgtype, msgtype.replace('/msg/', '/'), msgtype.rpartition('/')[2]):
            return msgtype
    raise ConfigError(
        f'type {name!r} cannot be used as a trajectory; needed one of {AUTOMATIC}, '
        f'{", ".join(TRAJECTORY_TYPES)}')


def find_frames(topic: str) -> tuple[str, str] | None:
    """Return the two frames of ``tf:PARENT.CHILD``, None for a topic."""
    return parse_tf(topic) if topic.startswith(TF_PREFIX) else None


def in_node_words(text: str) -> str:
    """Replace command-line options in a sentence by the parameters of the node."""
    def word(found: re.Match[str]) -> str:
        name = found[2].replace('-', '_')
        value = 'false' if found[1] else found[3]
        if name not in OPTIONS:
            return found[0]
        return f'{name}:={value}' if value else name

    return _COMMAND_OPTION.sub(word, text)


def parameter_file() -> str:
    """Return the text of the parameter file: all options with defaults and explanations."""
    lines = [
        '# Every parameter of calibration_node with its default. Copy, edit, and start with',
        '#   ros2 run trajectory_calibration calibration_node --ros-args --params-file FILE',
        '/**:',
        '  ros__parameters:']
    for title, changeable, options in _GROUPS:
        when = 'can be changed while the node runs' if changeable else 'read once at the start'
        lines += ['', f'    # --- {title}; {when} ---']
        for option in options:
            lines += _commented(option)
    return '\n'.join(lines) + '\n'


def _commented(option: Option) -> Iterable[str]:
    text = option.help[0].upper() + option.help[1:]
    if option.choices:
        text += f': {", ".join(option.choices)}'
    elif option.maximum < math.inf:
        text += f' ({option.minimum:.10g} to {option.maximum:.10g})'
    yield from textwrap.wrap(
        f'{text}.', 92, initial_indent='    # ', subsequent_indent='    # ')
    yield f'    {option.name}: {parameter_text(option.default)}'


def parameter_text(value: Any) -> str:
    """Return a value in YAML syntax."""
    return repr(value).lower() if isinstance(value, bool) else repr(value)


if __name__ == '__main__':
    sys.stdout.write(parameter_file())

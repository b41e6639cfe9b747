# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Advice about a pair with keys of RIG.yaml in place of options, which a rig does not have."""

from __future__ import annotations

import re

_PRIOR = re.compile(r'--prior-(translation|rotation)=(\S+) --prior-\1-std=(\d+(?:\.\d+)?)')
_OF_SENSOR = re.compile(r'--(invert|quaternion-order)(?:-([ab]))?(?: (wxyz|xyzw))?')
_SETTING = re.compile(r'--(association|max-time-difference|max-gap)=(\w[\w.+-]*\w|\w)')

# Advice for the node, which does not apply to a rig.
_PUBLISHED = re.compile(r', or(?:, in the node,)? set allow_unobserved[^.;]*')
_WHOLE = {
    '--invert-a --invert-b': '--invert-a and --invert-b',
    '--no-input-checks': 'input_checks: false in settings of RIG.yaml',
    '--time-unit': 'time_unit below the sensor in RIG.yaml',
}


def with_rig_keys(text: str, parent: str, child: str) -> str:
    """Return a message about a pair with keys of RIG.yaml in place of options.

    ``parent`` is sensor a of the pair, ``child`` sensor b.
    """
    def of_sensor(match: re.Match[str]) -> str:
        name = {'a': parent, 'b': child}.get(match[2], f'{parent} and {child}')
        return f'{_key(match[1])}: {match[3] or "true"} below {name} in RIG.yaml'

    text = _PUBLISHED.sub('', text)
    for option, key in _WHOLE.items():
        text = text.replace(option, key)
    text = _PRIOR.sub(lambda match: (
        f"prior_{match[1]}: '{match[2]}' and prior_{match[1]}_std: {match[3]} below {child} in "
        'RIG.yaml'), text)
    text = _OF_SENSOR.sub(of_sensor, text)
    return _SETTING.sub(
        lambda match: f'{_key(match[1])}: {match[2]} in settings of RIG.yaml', text)


def _key(option: str) -> str:
    return option.replace('-', '_')

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The nodes that calibrate a rig while it drives: one for each sensor, against the base.

``launch/rig.launch.py`` starts them; ``trajectory_calibration rig --from-results DIR`` makes one
rig of what they saved. The launch file itself is not imported here: ``launch`` is not on PyPI.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.rig.description import RigDescription


@dataclass(frozen=True)
class NodeSettings:
    """One node: its name, and the parameters that beat the file."""

    name: str
    parameters: dict[str, Any]


def nodes_of(path: Path, result_directory: str = '', *, sim_time: bool = False) -> list[
        NodeSettings]:
    """Return the nodes of RIG.yaml, every sensor as child of the base; ConfigError for files."""
    description = RigDescription.load(path)
    base = description.config.base or next(iter(description.inputs))
    if base not in description.inputs:
        raise ConfigError(f'the base {base!r} is none of the sensors: '
                          f'{", ".join(description.inputs)}')
    defaults = CalibrationConfig()
    shared = {name: value for name, value in description.config.calibration.to_dict().items()
              if value != getattr(defaults, name)}
    found = []
    for name, (source, options) in description.inputs.items():
        if options.of_files() or options.invert or Path(source).is_file():
            raise ConfigError(f'sensor {name} has a file, needed a topic or tf for a node')
        if name == base:
            continue
        settings = description.config.of(name)
        own: dict[str, Any] = {**settings.given}
        if settings.scale == 'free':
            own['scale_mode'] = 'estimate'
        if result_directory:
            own['result_directory'] = result_directory
        found.append(NodeSettings(
            # Of a ROS name: letters, digits and underscores.
            'calibrate_' + re.sub(r'\W', '_', name),
            {**shared, **own, 'use_sim_time': sim_time,
             'topic_a': description.inputs[base][0], 'topic_b': source,
             'frame_a': description.config.of(base).frame or base,
             'frame_b': settings.frame or name}))
    return found

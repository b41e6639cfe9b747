# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``verify`` and ``compare`` where the saved results are those of rigs: one table of sensors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import fields, replace
import json
from pathlib import Path

from trajectory_calibration.cli import exit_status
from trajectory_calibration.cli.progress import progress_bar, running_clock
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import make_folder, write_text
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.outputs.rig_comparison import (
    comparison_csv,
    comparison_data,
    format_comparison,
)
from trajectory_calibration.rig.calibration import calibrate_rig
from trajectory_calibration.rig.comparison import compare_rigs, RigComparison
from trajectory_calibration.rig.description import RigDescription
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.rig.settings import SensorSettings
from trajectory_calibration.sources.inputs import InputOptions, load_inputs


def verify_rig(
    saved: RigResult, settings: CalibrationConfig, arguments: argparse.Namespace,
) -> int:
    """Calibrate the sensors of RIG.yaml without priors, and compare with a saved rig."""
    if arguments.b is not None:
        raise ConfigError(f'{arguments.result} is a rig: give one RIG.yaml in place of A and B')
    for name in (f'{item.name}{of}' for item in fields(InputOptions) for of in ('', '_a', '_b')):
        if vars(arguments).get(name):
            option = name.removeprefix('file_').replace('_', '-')
            raise ConfigError(f'--{option} is for A and B; write how a sensor is read below it in '
                              f'{arguments.a}')
    description = RigDescription.load(Path(arguments.a))
    bags = [*description.bags, *map(Path, arguments.bag)]
    with progress_bar('reading') as progress:
        trajectories = load_inputs(description.inputs, bags, progress if bags else None)
    config = replace(
        saved.config, base=saved.base, calibration=settings, sensors={
            name: SensorSettings(scale=saved.config.of(name).scale) for name in trajectories})
    with running_clock('verifying'):
        found = compare_rigs(saved, calibrate_rig(trajectories, config))
    _print(found, arguments.format)
    return _status([found])


def compare_saved(paths: Sequence[Path], arguments: argparse.Namespace) -> int:
    """Compare saved rigs with the first of them."""
    first, *others = map(RigResult.load, paths)
    found = [compare_rigs(first, other) for other in others]
    for path, one in zip(paths[1:], found, strict=True):
        if arguments.format == 'text':
            print(f'{path} against {paths[0]}')
        _print(one, arguments.format)
        if arguments.output is not None:
            folder: Path = arguments.output / path.stem if len(others) > 1 else arguments.output
            make_folder(folder, ResultError)
            write_text(folder / 'table.csv', comparison_csv(one), ResultError)
            write_text(folder / 'table.json', json.dumps(comparison_data(one)) + '\n', ResultError)
    return _status(found)


def _print(found: RigComparison, form: str) -> None:
    """Print one table."""
    print(json.dumps(comparison_data(found)) if form == 'json' else
          comparison_csv(found) if form == 'csv' else format_comparison(found),
          end='\n' if form == 'json' else '')


def _status(found: Sequence[RigComparison]) -> int:
    """Return 4 where a sensor moved, 3 where one could not be compared."""
    if not all(item.holds for item in found):
        return exit_status.CHANGED
    return exit_status.DONE if all(item.whole for item in found) else exit_status.OPEN

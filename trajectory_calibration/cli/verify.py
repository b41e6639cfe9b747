# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration verify``: test whether a saved result holds on other data."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from trajectory_calibration.cli.inputs import add_input_arguments, load_pair
from trajectory_calibration.cli.options import (
    add_config_options,
    config_from_arguments,
    given_options,
)
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.fleet.verification import verify
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.result import is_rig, RigResult


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'verify', help='test whether a saved result holds on other data',
        usage='%(prog)s [options] RESULT A B\n       %(prog)s [options] RIG_RESULT RIG.yaml',
        description='Calibrate A and B without priors, and compare with a saved result. Exit '
        'status: 0 holds; 3 cannot tell, or not all directions were tested; 4 moved; 1 the data '
        'cannot be read, or A and B are exchanged. A saved rig is verified sensor by sensor on '
        'those of RIG.yaml.')
    parser.add_argument('result', type=Path, metavar='RESULT', help='result.yaml or rig.yaml')
    add_input_arguments(parser, pair=False)
    parser.add_argument(
        '--format', choices=('text', 'json'), default='text', help='output format')
    add_config_options(parser, without=('prior_', 'allow_unobserved'))


def run(arguments: argparse.Namespace) -> int:
    """Verify and print the verdict."""
    if is_rig(arguments.result):
        from trajectory_calibration.cli.rig import verify_rig
        rig = RigResult.load(arguments.result)
        return verify_rig(rig, _config(rig.config.calibration, arguments), arguments)
    if arguments.b is None:
        raise ConfigError(f'B is missing: {arguments.result} is verified on two trajectories')
    result = CalibrationResult.load(arguments.result)
    config = _config(result.config, arguments)
    a, b = load_pair(arguments, (result.frame_a, result.frame_b))
    with progress('verifying'):
        verification = verify(result, a, b, config)
    if arguments.format == 'json':
        print(json.dumps(verification.to_dict()))
        return verification.exit_status
    print(verification.describe())
    if resolution := verification.describe_resolution():
        print(f'smallest shift that would have been noticed: {resolution}')
    # Not those of directions: the verdict names them, and their advice of a prior is no use here.
    findings = () if verification.result is None else verification.result.findings
    for line in (*(f'note: {note}' for note in verification.notes), *(
            f'{item.level}: {item.text}' for item in findings
            if not item.code.startswith('direction-'))):
        print(line)
    return verification.exit_status


def _config(saved: CalibrationConfig, arguments: argparse.Namespace) -> CalibrationConfig:
    """Return the settings of the saved result, overridden by the options, or those of --config."""
    if arguments.config is not None:
        return config_from_arguments(arguments)
    try:
        return CalibrationConfig.from_dict({**saved.to_dict(), **given_options(arguments)})
    except ConfigError as error:
        raise ConfigError(f'settings of {arguments.result} with the options: {error}. Others can '
                          'be given with --config FILE') from error

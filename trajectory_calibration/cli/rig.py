# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration rig``: all sensors of a vehicle in one consistent answer."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
import json
from pathlib import Path
import sys
from typing import Any

from trajectory_calibration.cli import exit_status
from trajectory_calibration.cli.inputs import add_bag_argument
from trajectory_calibration.cli.progress import progress_bar, running_clock
from trajectory_calibration.cli.report import record_of, require_new
from trajectory_calibration.config.yaml_file import make_folder, to_yaml, write_text
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.rig_exports import (
    KIT_FILE,
    LAUNCH_FILE,
    MATRICES_FILE,
    URDF_FILE,
    write_rig_exports,
)
from trajectory_calibration.outputs.rig_screen import format_rig
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.calibration import calibrate_rig, fuse_results
from trajectory_calibration.rig.description import RigDescription
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.rig.settings import PAIRS, RigConfig
from trajectory_calibration.sources.inputs import load_inputs

RIG_FILE = 'rig.yaml'


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'rig', help='find the extrinsics of all sensors of a vehicle at once',
        usage='%(prog)s [options] RIG.yaml',
        description='Find the poses of all sensors of a vehicle in its base, consistent round '
        'every loop, and name the sensor that does not fit.',
        epilog='Exit status: 0 done; 3 done, but a sensor or a direction of it is unknown; '
        '1 no answer; 2 wrong usage.')
    parser.add_argument(
        'rig', metavar='RIG.yaml', type=Path, nargs='?',
        help='base, sensors with a topic, tf or file each, and settings: see docs/rig.md')
    add_bag_argument(parser)
    parser.add_argument(
        '--from-results', type=Path, metavar='DIR',
        help='make the rig of the results of pairs (.yaml) in a folder, such as nodes save')
    parser.add_argument('--base', metavar='NAME', help='sensor whose frame is that of the rig')
    parser.add_argument('--pairs', choices=PAIRS, help='which pairs are calibrated')
    parser.add_argument(
        '--leave-out-contradicting', action='store_true',
        help='leave sensors that contradict the others out of the answer')
    parser.add_argument(
        '--allow-unobserved', action='store_true',
        help='export sensors with an unknown direction, too, as arbitrary numbers with a comment')
    group = parser.add_argument_group('output')
    group.add_argument(
        '--ground-truth', type=Path, metavar='FILE', help='a saved rig with known poses')
    group.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text', help='on the screen')
    group.add_argument(
        '-v', '--verbose', action='store_true', help='show all findings and all pairs')
    group.add_argument(
        '--output', type=Path, metavar='DIR', help=f'folder for the rig ({RIG_FILE}), URDF, '
        'launch file, sensor_kit_calibration.yaml, and all exports of each sensor')
    group.add_argument(
        '--report', type=Path, metavar='FILE.html', help='page that shows what the rig rests on')
    group.add_argument('--force', action='store_true', help='overwrite files')


def run(arguments: argparse.Namespace) -> int:
    """Calibrate a rig and print it."""
    require_new(_files(arguments), force=arguments.force)
    truth = None if arguments.ground_truth is None else {
        name: sensor.T_base_sensor
        for name, sensor in RigResult.load(arguments.ground_truth).sensors.items()}
    trajectories: Mapping[str, Trajectory] = {}
    sources: list[tuple[str, Path]] = []
    if arguments.from_results is not None:
        rig = _from_results(arguments)
    elif arguments.rig is None:
        raise ConfigError('RIG.yaml is missing; give it, or --from-results DIR')
    else:
        description = RigDescription.load(arguments.rig)
        bags = [*description.bags, *map(Path, arguments.bag)]
        config = _configured(description.config, arguments)
        sources = [('bag', bag) for bag in bags] + [
            (name, Path(source)) for name, (source, _) in description.inputs.items()
            if Path(source).is_file()]
        with progress_bar('reading') as progress:
            trajectories = load_inputs(description.inputs, bags, progress if bags else None)
        with running_clock('calibrating'):
            rig = calibrate_rig(trajectories, config)
    if arguments.output is not None:
        make_folder(arguments.output, ResultError)
        rig.save(arguments.output / RIG_FILE)
        kept_back = write_rig_exports(rig, arguments.output)
        if kept_back:
            print(f'not exported: {"; ".join(kept_back)} unknown; rig --allow-unobserved writes '
                  'them', file=sys.stderr)
    if arguments.report is not None:
        _write_report(rig, trajectories, sources, arguments)
    _print(rig, truth, arguments)
    stream = sys.stdout if arguments.format == 'text' else sys.stderr
    for path in (arguments.output, arguments.report):
        if path is not None:
            print(f'wrote {path}', file=stream)
    return exit_status.OPEN if rig.unobserved or rig.unplaced else exit_status.DONE


def _files(arguments: argparse.Namespace) -> list[Path]:
    """Return the files that will be written, but for the folders of single sensors."""
    files = [] if arguments.output is None else [
        arguments.output / name
        for name in (RIG_FILE, URDF_FILE, LAUNCH_FILE, KIT_FILE, MATRICES_FILE)]
    return files if arguments.report is None else [*files, arguments.report]


def _write_report(
    rig: RigResult, trajectories: Mapping[str, Trajectory], sources: list[tuple[str, Path]],
    arguments: argparse.Namespace,
) -> None:
    from trajectory_calibration.outputs.rig_report import render_rig
    with running_clock('writing the report'):
        text = render_rig(rig, trajectories, record_of(arguments, sources))
    write_text(arguments.report, text, ResultError)


def _configured(config: RigConfig, arguments: argparse.Namespace) -> RigConfig:
    """Return the settings of the file, overridden by the options."""
    given: dict[str, Any] = {name: getattr(arguments, name) for name in ('base', 'pairs')
                             if getattr(arguments, name) is not None}
    if arguments.leave_out_contradicting:
        given['leave_out_contradicting'] = True
    if arguments.allow_unobserved:
        given['calibration'] = replace(config.calibration, allow_unobserved=True)
    return replace(config, **given)


def _from_results(arguments: argparse.Namespace) -> RigResult:
    if arguments.bag:
        raise ConfigError('--bag has no meaning with --from-results')
    config = (RigConfig() if arguments.rig is None
              else _by_frames(RigDescription.load(arguments.rig).config))
    folder: Path = arguments.from_results
    paths = sorted(folder.rglob('*.yaml'))
    if not paths:
        raise ConfigError(f'{folder} holds no .yaml; needed results that calibrate or a node '
                          'saved')
    results: dict[frozenset[str], CalibrationResult] = {}
    failures = []
    for path in paths:
        try:
            result = CalibrationResult.load(path)
        except ResultError as error:
            failures.append(f'{path.name}: {error}')
            continue
        # Files are named by their time: of one pair the last one counts.
        results[frozenset((result.frame_a, result.frame_b))] = result
    if not results:
        raise ConfigError(f'{folder} holds no results: {failures[0]}')
    return fuse_results(list(results.values()), _configured(config, arguments))


def _by_frames(config: RigConfig) -> RigConfig:
    """Return the settings with the frames of the sensors as their names, as results have it."""
    frames = {name: sensor.frame or name for name, sensor in config.sensors.items()}
    return replace(
        config, base=frames.get(config.base, config.base),
        sensors={frames[name]: sensor for name, sensor in config.sensors.items()})


def _print(
    rig: RigResult, truth: Mapping[str, FloatArray] | None, arguments: argparse.Namespace,
) -> None:
    if arguments.format == 'json':
        print(json.dumps(rig.to_dict()))
    elif arguments.format == 'yaml':
        print(to_yaml(rig.to_dict()), end='')
    else:
        print(format_rig(rig, truth=truth, verbose=arguments.verbose, terminal=Terminal.of()),
              end='')

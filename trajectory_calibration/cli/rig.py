# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``rig``: calibrate all sensors of a vehicle; ``verify``, ``compare``, ``report`` for rigs."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
import json
from pathlib import Path
import sys
from typing import Any, TYPE_CHECKING

from trajectory_calibration import exit_status
from trajectory_calibration.cli.inputs import add_bag_argument
from trajectory_calibration.cli.options import refuse_options
from trajectory_calibration.cli.progress import progress
from trajectory_calibration.cli.writing import (
    print_as,
    print_table,
    record_of,
    require_new,
    write_answer,
)
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.data.trajectory import recording_of, Trajectory
from trajectory_calibration.errors import ConfigError, ResultError
from trajectory_calibration.fleet.comparison import short_names
from trajectory_calibration.outputs.comparison_table import csv_text, rig_to_data, rig_to_text
from trajectory_calibration.outputs.exports import EXPORT_FILES
from trajectory_calibration.outputs.placement import kept_back
from trajectory_calibration.outputs.rig_exports import (
    placements_by_folder,
    require_own_frames,
    rig_export_files,
    rig_exports,
    RIG_FILE,
    RIG_FILES,
)
from trajectory_calibration.outputs.rig_screen import format_rig
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.rig.calibration import calibrate_rig, fuse_results
from trajectory_calibration.rig.comparison import compare_rigs, RigComparison
from trajectory_calibration.rig.description import RigDescription
from trajectory_calibration.rig.result import RigResult
from trajectory_calibration.rig.saved import read_results
from trajectory_calibration.rig.settings import PAIRS, RigConfig, SensorSettings
from trajectory_calibration.sources.inputs import InputOptions, load_inputs

if TYPE_CHECKING:
    from trajectory_calibration.outputs.report import Record

# The files that compare writes to --output for rigs.
RIG_TABLES = ('table.csv', 'table.json')


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'rig', help='find the extrinsics of all sensors of a vehicle at once',
        usage='%(prog)s [options] RIG.yaml',
        description='Find the poses of all sensors of a vehicle in its base, consistent round '
        'every loop, and name the sensor that does not fit.',
        epilog='Exit status: 0 done; 3 done, but a sensor or a direction of it is unobservable; '
        '1 no answer; 2 wrong usage.')
    parser.add_argument(
        'rig', metavar='RIG.yaml', type=Path, nargs='?',
        help='base, sensors with a topic, tf or file each, and settings: see docs/rig.md')
    add_bag_argument(parser)
    parser.add_argument(
        '--from-results', type=Path, metavar='DIR',
        help='make the rig of the results of pairs (.yaml) in a folder, such as nodes save')
    parser.add_argument('--base', metavar='NAME', help='sensor whose frame is that of the rig')
    parser.add_argument(
        '--pairs', choices=PAIRS, help='pairs to calibrate: all; base: each sensor with the base; '
        'auto: all, but fewer with more than four sensors')
    parser.add_argument(
        '--leave-out-contradicting', action='store_true',
        help='leave sensors that contradict the others out of the answer')
    parser.add_argument(
        '--allow-unobserved', action='store_true',
        help='export unobservable directions, too, as arbitrary numbers with a comment')
    group = parser.add_argument_group('output')
    group.add_argument(
        '--ground-truth', type=Path, metavar='FILE', help='a saved rig with known poses')
    group.add_argument(
        '--format', choices=('text', 'json', 'yaml'), default='text', help='output format')
    group.add_argument(
        '-v', '--verbose', action='store_true', help='show all findings and all pairs')
    group.add_argument(
        '--output', type=Path, metavar='DIR', help=f'folder for the rig ({RIG_FILE}), URDF, '
        'launch file, sensor_kit_calibration.yaml, and all exports of each sensor')
    group.add_argument(
        '--report', type=Path, metavar='FILE.html', help='HTML page with the evidence for the rig')
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
        config = _configured(description.config, arguments)
        sources, trajectories = _read(description, arguments)
        if arguments.output is not None:
            # Exports need unique frames: checked before the calibration, not after it.
            require_own_frames({name: config.of(name).frame or trajectory.sensor_frame
                                for name, trajectory in trajectories.items()})
        with progress('calibrating'):
            rig = calibrate_rig(trajectories, config)
    # The answer is printed even if a file cannot be written, and the files are written even if
    # the pipe is closed.
    try:
        print_as(arguments.format, rig.to_dict(), format_rig(
            rig, truth=truth, verbose=arguments.verbose, terminal=Terminal.of()))
    finally:
        if arguments.output is not None:
            _write(rig, arguments.output, force=arguments.force)
        if arguments.report is not None:
            write_rig_page(rig, trajectories, record_of(arguments, sources), arguments.report)
    stream = sys.stdout if arguments.format == 'text' else sys.stderr
    for path in (arguments.output, arguments.report):
        if path is not None:
            print(f'wrote {path}', file=stream)
    return _status_of(rig)


def _status_of(rig: RigResult) -> int:
    return exit_status.INCOMPLETE if rig.unobserved or rig.unplaced else exit_status.DONE


def write_rig_page(
    rig: RigResult, trajectories: Mapping[str, Trajectory], record: Record, path: Path,
) -> None:
    """Write the HTML page of a rig."""
    from trajectory_calibration.outputs.rig_report import render_rig
    with progress('writing the report'):
        write_text(path, render_rig(rig, trajectories, record))


def _files(arguments: argparse.Namespace) -> list[Path]:
    """Return the output files without those whose names depend on the sensors."""
    files = [] if arguments.output is None else [
        arguments.output / name for name in (RIG_FILE, *RIG_FILES.values())]
    return files if arguments.report is None else [*files, arguments.report]


def _write(rig: RigResult, folder: Path, *, force: bool) -> None:
    """Write the rig and its exports; print what is not exported, and what is removed."""
    placed = placements_by_folder(rig)
    names = rig_export_files(placed)
    # Also the names that are not exported now: old files are removed with --force only.
    require_new([folder / name for name in names], force=force)
    with suppress(ResultError, ConfigError):
        # Also exports of sensors that had an answer in the earlier rig only.
        names += rig_export_files(placements_by_folder(RigResult.load(folder / RIG_FILE)))
    write_answer(
        folder / RIG_FILE, rig.to_dict(), rig_exports(rig, placed), dict.fromkeys(names),
        kept_back(placed.values()))


def _read(
    description: RigDescription, arguments: argparse.Namespace,
) -> tuple[list[tuple[str, Path]], dict[str, Trajectory]]:
    """Return the bags and files, each with its role, and the trajectory of each sensor."""
    bags = [*description.bags, *map(Path, arguments.bag)]
    with progress('reading') as draw:
        trajectories = load_inputs(description.inputs, bags, draw)
    return [('bag', bag) for bag in bags] + [
        (name, Path(source)) for name, (source, _) in description.inputs.items()
        if Path(source).is_file()], trajectories


def _configured(config: RigConfig, arguments: argparse.Namespace) -> RigConfig:
    """Return the settings overridden by the options."""
    given: dict[str, Any] = {
        name: value for name in ('base', 'pairs', 'leave_out_contradicting')
        if (value := getattr(arguments, name))}
    if arguments.allow_unobserved:
        given['calibration'] = replace(config.calibration, allow_unobserved=True)
    return replace(config, **given)


def _from_results(arguments: argparse.Namespace) -> RigResult:
    if arguments.bag:
        raise ConfigError('--bag has no meaning with --from-results')
    config = (RigConfig() if arguments.rig is None
              else _by_frames(RigDescription.load(arguments.rig).config))
    folder: Path = arguments.from_results
    # The folder may also hold a saved rig, or the exports of a result.
    others = {*EXPORT_FILES, *RIG_FILES.values(), RIG_FILE}
    paths = [path for path in folder.rglob('*.yaml')
             if path.name not in others and path != arguments.rig]
    results, findings = read_results(paths, folder)
    rig = fuse_results(results, _configured(config, arguments))
    return replace(rig, findings=worst_first((*rig.findings, *findings)))


def _by_frames(config: RigConfig) -> RigConfig:
    """Return the settings with the sensors named by their frames, as in saved results."""
    frames = {name: sensor.frame or name for name, sensor in config.sensors.items()}
    return replace(
        config, base=frames.get(config.base, config.base),
        sensors={frames[name]: sensor for name, sensor in config.sensors.items()})


def _read_rig_inputs(
    arguments: argparse.Namespace,
) -> tuple[list[tuple[str, Path]], dict[str, Trajectory]]:
    """Return ``_read`` for the RIG.yaml that is given in place of A and B."""
    if arguments.b is not None:
        raise ConfigError(f'{arguments.result} is a rig: give one RIG.yaml in place of A and B')
    names = (f'{item.name}{end}' for item in fields(InputOptions) for end in ('', '_a', '_b'))
    refuse_options(
        arguments, names, f'is for A and B; write how a sensor is read below it in {arguments.a}')
    return _read(RigDescription.load(Path(arguments.a)), arguments)


def report_rig(arguments: argparse.Namespace) -> int:
    """Write the HTML page of a saved rig with the trajectories of RIG.yaml."""
    refuse_options(arguments, ('ground_truth', 'plots'),
                   f'is for one pair, and {arguments.result} is a rig; leave it out')
    rig = RigResult.load(arguments.result)
    page: Path = arguments.output or arguments.result.with_suffix('.html')
    require_new([page], force=arguments.force)
    sources, trajectories = _read_rig_inputs(arguments)
    others = [name for name, trajectory in trajectories.items()
              if name in rig.sensors and recording_of(trajectory) not in rig.recordings]
    if rig.recordings and others:
        finding = Finding('recording-other', (
            f'{", ".join(others)} of {arguments.a}: not the trajectories of {arguments.result}. '
            'The page shows how well its answer fits them. Give those that it was made from, or '
            'use verify'))
        rig = replace(rig, findings=(finding, *rig.findings))
        print(f'{finding.level}: {finding}', file=sys.stderr)
    write_rig_page(rig, trajectories, record_of(arguments, sources), page)
    print(f'wrote {page}')
    return _status_of(rig)


def verify_rig(
    saved: RigResult, settings: CalibrationConfig, arguments: argparse.Namespace,
) -> int:
    """Calibrate the sensors of RIG.yaml without priors, and compare with a saved rig."""
    _, trajectories = _read_rig_inputs(arguments)
    config = replace(
        saved.config, base=saved.base, calibration=settings, sensors={
            name: SensorSettings(scale=saved.config.of(name).scale) for name in trajectories})
    with progress('verifying'):
        comparison = compare_rigs(saved, calibrate_rig(trajectories, config))
    print_as(arguments.format, rig_to_data(comparison), rig_to_text(comparison))
    return _status([comparison])


def compare_saved(paths: Sequence[Path], arguments: argparse.Namespace) -> int:
    """Compare saved rigs with the first one."""
    if arguments.output is not None:
        require_new([arguments.output / name for name in RIG_TABLES], force=arguments.force)
    against, *names = short_names(list(map(str, paths)))
    first, *others = map(RigResult.load, paths)
    comparisons = [compare_rigs(first, other) for other in others]
    named = list(zip(names, comparisons, strict=True))
    rows = [{'rig': name, 'against': against, **rig_to_data(item)} for name, item in named]
    table = csv_text([{'rig': item['rig'], **row} for item in rows for row in item['sensors']])
    data = json.dumps(rows) + '\n'
    text = '\n'.join(f'{name} against {against}: {rig_to_text(item)}' for name, item in named)
    print_table({'text': text, 'csv': table, 'json': data}[arguments.format],
                zip(RIG_TABLES, (table, data), strict=True), arguments)
    return _status(comparisons)


def _status(comparisons: Sequence[RigComparison]) -> int:
    """Return 4 if a sensor moved, 3 if one could not be compared."""
    if not all(item.holds for item in comparisons):
        return exit_status.CHANGED
    return (exit_status.DONE if all(item.whole for item in comparisons)
            else exit_status.INCOMPLETE)

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Output that several subcommands share: results, reports, plots; and the ground truth."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
import json
import os
from pathlib import Path
import shlex
import sys
from typing import Any, TYPE_CHECKING

from trajectory_calibration.cli.progress import progress
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import make_folder, to_yaml, write_text, write_yaml
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import CalibrationError, ConfigError, ResultError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.extrinsic_file import FORMS, read_extrinsic
from trajectory_calibration.result import CalibrationResult

if TYPE_CHECKING:
    from trajectory_calibration.outputs.report import Record


def add_truth_argument(parser: argparse.ArgumentParser) -> None:
    """Add ``--ground-truth``."""
    parser.add_argument(
        '--ground-truth', metavar='FILE', help=f'known pose of b in a: {FORMS}')


def read_truth(name: str | None, frame_a: str, frame_b: str) -> FloatArray | None:
    """Return the known (4, 4) pose of b in a, or None without a file."""
    if name is None:
        return None
    truth = read_extrinsic(name, frame_a, frame_b)
    if 'inverted' in truth.how:
        # Of these formats a user may expect the other direction.
        print(f'ground truth: {truth.how}', file=sys.stderr)
    return truth.T_a_b


def print_as(form: str, data: dict[str, Any], text: str) -> None:
    """Print data as JSON or YAML, or else ``text``, which ends with a line break; flush it."""
    if form == 'json':
        text = json.dumps(data) + '\n'
    elif form == 'yaml':
        text = to_yaml(data)
    print(text, end='', flush=True)


def require_new(paths: Iterable[Path], *, force: bool) -> None:
    """Check before the calibration that the files can be written.

    Raises ConfigError for files that exist, unless ``force``; ResultError for a folder that
    cannot be made or written to.
    """
    paths = list(paths)
    existing = [path for path in paths if path.is_file()]
    if existing and not force:
        exist = f'and {len(existing) - 1} more exist' if len(existing) > 1 else 'exists'
        raise ConfigError(f'{existing[0]} {exist}; give --force to overwrite, or another name')
    for path in paths:
        if path.is_dir():
            raise ResultError(f'{path} cannot be written: it is a folder; give another name')
        # The target of a link is replaced, not the link.
        folder = (path.resolve() if path.is_file() else path).parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            raise ResultError(f'{path.parent} cannot be made: {folder} is a file; give another '
                              'name')
        # Replacing a file needs a writable folder; a device or a pipe is not replaced.
        if (path.is_file() or not path.exists()) and not os.access(folder, os.W_OK | os.X_OK):
            raise ResultError(f'{folder.resolve()} cannot be written to; give another name, or '
                              'correct its permissions')


def plot_paths(folder: Path | None) -> list[Path]:
    """Return the files of ``--plots``; raises MissingPackageError without Matplotlib."""
    if folder is None:
        return []
    from trajectory_calibration.outputs.plots import plot_files
    return plot_files(folder)


def print_table(
    text: str, files: Iterable[tuple[str, str]], arguments: argparse.Namespace,
) -> None:
    """Print a comparison, and write ``files`` (name, content) to the folder ``--output``."""
    # The files are written even if the pipe is closed.
    try:
        print(text, end='', flush=True)
    finally:
        if arguments.output is not None:
            contents = dict(files)
            for name, data in contents.items():
                write_text(arguments.output / name, data)
            print(f'wrote {arguments.output}/{", ".join(contents)}', file=sys.stderr)


def write_answer(
    path: Path, data: dict[str, Any], exports: Mapping[str, str | bytes], names: Iterable[str],
    hidden: str,
) -> None:
    """Write an answer as YAML, and its exports in the same folder.

    Exports of an earlier answer with one of the ``names`` are removed unless they are written
    again. Prints what was removed, and ``hidden``, the directions that are not exported.
    """
    from trajectory_calibration.outputs.exports import remove_others
    folder = path.parent
    try:
        make_folder(folder, ResultError)
        removed = remove_others(folder, names, exports)
        write_yaml(path, data)
        for name, contents in exports.items():
            write_text(folder / name, contents)
    except ResultError as error:
        raise ResultError(f'{error}; give another --output') from error
    if hidden:
        print(f'not exported: {hidden} unobservable. To write it anyway: --allow-unobserved, here '
              f'or in export {shlex.quote(str(path))} --as FORMAT', file=sys.stderr)
    if removed:
        print(f'removed from {folder}, as of an earlier answer: '
              f'{", ".join(str(path.relative_to(folder)) for path in removed)}', file=sys.stderr)


def write_pages(
    result: CalibrationResult, a: Trajectory, b: Trajectory, truth: FloatArray | None,
    arguments: argparse.Namespace, page: Path | None,
) -> list[Path]:
    """Write the HTML page and the plots if requested; return their paths."""
    if page is None and arguments.plots is None:
        return []
    from trajectory_calibration.outputs.report.data import report_data
    from trajectory_calibration.outputs.report.render import render
    written = []
    record = None if page is None else record_of(arguments, _inputs(arguments))
    with progress('writing the report'):
        data = report_data(result, a, b, truth)
        if page is not None:
            write_text(page, render(data, record))
            written.append(page)
        if arguments.plots is not None:
            from trajectory_calibration.outputs.plots import save_plots
            save_plots(data, arguments.plots)
            written.append(arguments.plots)
    return written


def write_failure(
    error: Exception, trajectories: tuple[Trajectory, ...], config: CalibrationConfig,
    arguments: argparse.Namespace,
) -> None:
    """Write the HTML page of a failed calibration.

    If this fails, too, the reason is printed, and the error of the calibration remains.
    """
    from trajectory_calibration.outputs.report import render_failure
    try:
        write_text(arguments.report, render_failure(
            str(error), trajectories, config=config,
            record=record_of(arguments, _inputs(arguments))))
    except CalibrationError as failure:
        print(f'no report: {failure}', file=sys.stderr)
    else:
        print(f'wrote {arguments.report}', file=sys.stderr)


def record_of(arguments: argparse.Namespace, inputs: Sequence[tuple[str, Path]]) -> Record:
    """Return the command line and the hashes of the inputs."""
    from trajectory_calibration.outputs.report import hash_inputs, Record
    with progress('hashing the inputs') as draw:
        hashed = hash_inputs(inputs, draw)
    return Record(shlex.join(['trajectory_calibration', *arguments.argv]), hashed)


def _inputs(arguments: argparse.Namespace) -> list[tuple[str, Path]]:
    return [('bag', Path(bag)) for bag in arguments.bag] + [
        (name, Path(getattr(arguments, name))) for name in 'ab'
        if Path(getattr(arguments, name)).is_file()]

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``trajectory_calibration export``: write a saved result in the formats of other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
from textwrap import fill

from trajectory_calibration import exit_status
from trajectory_calibration.cli.options import refuse_options
from trajectory_calibration.cli.writing import require_new
from trajectory_calibration.config.yaml_file import write_text
from trajectory_calibration.errors import ConfigError
from trajectory_calibration.outputs.exports import EXPORTS
from trajectory_calibration.outputs.extrinsic_file import transform_of
from trajectory_calibration.outputs.frame_tree import FrameTree
from trajectory_calibration.outputs.placement import kept_back, Placement
from trajectory_calibration.outputs.rig_exports import encode_rig, placements, RIG_FILES
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.result import is_rig, RigResult


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the subcommand."""
    formats = '\n'.join(fill(
        item.sentence, 79, initial_indent=f'  {name:<10} ', subsequent_indent=13 * ' ')
        for name, item in EXPORTS.items())
    parser = subparsers.add_parser(
        'export', help='write a saved result as URDF, static transform, Autoware, Kalibr, ...',
        usage='%(prog)s RESULT --as FORMAT [options]',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description='Write the extrinsic of a saved result for another tool. The parent is '
        'sensor a,\nthe child sensor b, unless --invert, --parent or --child say otherwise.',
        epilog=f'formats:\n{formats}\n\nTRANSFORM is x,y,z,roll,pitch,yaw (metres, radians, as in '
        'URDF),\nx,y,z,qx,qy,qz,qw, or a file.\n\nA rig is written as a whole, as '
        f'{", ".join(RIG_FILES)}.\n\nExit status: 0 done; 3 written with an unobservable '
        'direction\n(--allow-unobserved); 1 not written.')
    parser.add_argument('result', type=Path, metavar='RESULT', help='result.yaml or rig.yaml')
    parser.add_argument(
        '--as', dest='format', required=True, choices=tuple(EXPORTS), metavar='FORMAT',
        help=', '.join(EXPORTS))
    parser.add_argument(
        '--invert', action='store_true', help='write the pose of a in b: b becomes the parent')
    parser.add_argument(
        '--parent', metavar='FRAME', help='frame to which the parent is fixed, as base_link; the '
        'child is written in it')
    parser.add_argument(
        '--parent-transform', metavar='TRANSFORM', help='pose of the parent sensor in --parent')
    parser.add_argument(
        '--child', metavar='FRAME', help='frame to which the child is fixed, as camera_link of an '
        'optical frame; it is written in place of the child')
    parser.add_argument(
        '--child-transform', metavar='TRANSFORM', help='pose of the child sensor in --child')
    parser.add_argument(
        '--parent-urdf', '--urdf', type=Path, metavar='FILE',
        help='URDF whose fixed joints give the transforms of --parent and --child')
    parser.add_argument(
        '--output', type=Path, metavar='FILE', help='file to write (default: standard output)')
    parser.add_argument('--force', action='store_true', help='overwrite the file')
    parser.add_argument(
        '--allow-unobserved', action='store_true', help='write unobservable directions, too, '
        'as arbitrary numbers with a comment')


def run(arguments: argparse.Namespace) -> int:
    """Write the export."""
    exporter = EXPORTS[arguments.format]
    rig = RigResult.load(arguments.result) if is_rig(arguments.result) else None
    if rig is None:
        items = [_placed(Placement.of(CalibrationResult.load(arguments.result)), arguments)]
    else:
        _require_of_rigs(arguments)
        items = placements(rig)
    hidden = kept_back(items)
    if hidden and not arguments.allow_unobserved:
        print(f'error: not exported: {hidden} unobservable. Calibrate with a ramp or a prior; or '
              'export an arbitrary number with --allow-unobserved', file=sys.stderr)
        return exit_status.NO_ANSWER
    if rig is not None:
        content: str | bytes = encode_rig(rig, arguments.format, items).decode()
    else:
        content = exporter.encode(items[0]) if arguments.output else exporter.write(items[0])
    if arguments.output is None:
        print(content, end='')
    else:
        require_new([arguments.output], force=arguments.force)
        write_text(arguments.output, content)
        print(f'wrote {arguments.output}: {exporter.sentence}', file=sys.stderr)
    unobserved = ', '.join(name for item in items for name in item.unobserved)
    if unobserved:
        print(f'warning: unobservable: {unobserved}; the numbers are arbitrary along it',
              file=sys.stderr)
    incomplete = unobserved or (rig is not None and rig.unplaced)
    return exit_status.INCOMPLETE if incomplete else exit_status.DONE


def _require_of_rigs(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for a format or an option that is not available for a rig."""
    if arguments.format not in RIG_FILES:
        raise ConfigError(
            f'{arguments.format} holds one transform, and {arguments.result} is a rig; needed '
            f'--as {", ".join(RIG_FILES)}. rig --output writes every format of each sensor')
    refuse_options(
        arguments, ('invert', 'parent', 'child', 'parent_transform', 'child_transform',
                    'parent_urdf'),
        f'is for one transform, and {arguments.result} is a rig; rig --base chooses the frame of '
        'all')


def _placed(item: Placement, arguments: argparse.Namespace) -> Placement:
    """Return the placement between the frames of the options."""
    if arguments.invert:
        item = item.inverted()
    tree = None if arguments.parent_urdf is None else FrameTree.read(arguments.parent_urdf)
    for end in ('parent', 'child'):
        frame, text = getattr(arguments, end), getattr(arguments, f'{end}_transform')
        if frame is None:
            if text is not None:
                raise ConfigError(f'--{end}-transform needs the name of its frame, --{end} FRAME')
            continue
        sensor = item.parent if end == 'parent' else item.child
        if text is not None:
            T_frame_sensor = transform_of(text)
        elif tree is not None:
            T_frame_sensor = tree.transform(frame, sensor)
        else:
            raise ConfigError(
                f'--{end} {frame} needs the pose of {sensor} in it: --{end}-transform '
                'x,y,z,roll,pitch,yaw, or --parent-urdf FILE')
        item = (item.with_parent(frame, T_frame_sensor) if end == 'parent'
                else item.with_child(frame, T_frame_sensor))
    joint = None if tree is None else tree.joints.get(item.child)
    parent = joint.parent if joint else ''
    if parent not in ('', item.parent):
        raise ConfigError(
            f'{item.child} already has the parent {parent} in {arguments.parent_urdf}, and a '
            f'link has one; give --child {parent}, so that {parent} is placed in {item.parent}')
    return item

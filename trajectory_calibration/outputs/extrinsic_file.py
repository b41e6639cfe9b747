# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reader of a known extrinsic from files of many formats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
import re
from typing import Any, NamedTuple, TypeVar

import numpy as np

from trajectory_calibration.config.yaml_file import parse_yaml
from trajectory_calibration.data.trajectory import ROTATION_TOLERANCE
from trajectory_calibration.errors import ConfigError, counted, in_words, SourceError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.frame_tree import FrameTree, numbers_of

FORMS = (
    'one row [t] x y z qx qy qz qw; 4 x 4 or 3 x 4 numbers (text or .npy); x y z roll pitch yaw '
    'in metres and radians; URDF <origin>; KITTI calib file; Kalibr camchain; Autoware sensor '
    'kit; a saved result; an export of this tool')

_AS_POSE = 'taken as the pose of b in a'
_T = TypeVar('_T')


class KnownExtrinsic(NamedTuple):
    """The (4, 4) pose of b in a, metres; ``how`` names the format and the frames of the file."""

    T_a_b: FloatArray
    how: str


def read_extrinsic(
    path: str | Path, frame_a: str | None = None, frame_b: str | None = None,
) -> KnownExtrinsic:
    """Read the pose of b in a; the transforms of Kalibr and KITTI files are inverted.

    Parameters
    ----------
    path : str or Path
        The file. ``FILE#NAME`` picks one of several: a joint or child link of a URDF, a camera
        of a Kalibr chain, a sensor of an Autoware kit, ``02`` of a KITTI cam_to_cam file.
    frame_a, frame_b : str, optional
        Frames that are searched first in a URDF or an Autoware kit.

    Raises
    ------
    SourceError
        The file cannot be read, holds none of ``FORMS``, or several transforms.

    """
    file, key = Path(path), None
    if '#' in str(path) and not file.exists():
        name, _, key = str(path).rpartition('#')
        file = Path(name)
    try:
        data = file.read_bytes()
        if data.startswith(b'\x93NUMPY'):
            matrix = np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
            return KnownExtrinsic(_rigid(matrix, file), f'4 x 4 array, {_AS_POSE}')
        text = data.decode('utf-8-sig')
    except UnicodeDecodeError:
        raise SourceError(f'{file} is no text; needed {FORMS}') from None
    except ValueError as error:
        raise SourceError(f'{file} cannot be read as a NumPy array: {error}') from error
    except OSError as error:
        raise SourceError(f'{file} cannot be read: {error.strerror or error}') from error
    if text.lstrip().startswith('<'):
        return _from_urdf(FrameTree.parse(text, file), key, frame_a, frame_b)
    if file.suffix in ('.yaml', '.yml', '.json'):
        found = parse_yaml(text, f'{file} cannot be read as YAML', SourceError)
        try:
            return _from_mapping(found, file, key, frame_a, frame_b)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise SourceError(
                f'{file} holds no transform ({in_words(error)}); needed {FORMS}') from error
    lines = [line for line in map(str.strip, text.splitlines()) if line and line[0] != '#']
    named = dict(line.split(':', 1) for line in lines if re.match(r'\w+:', line))
    return _from_kitti(named, file, key) if named else _from_numbers(lines, file)


def transform_of(text: str) -> FloatArray:
    """Return the (4, 4) pose from a file, or from numbers as in ``parse_transform``.

    Raises ConfigError for numbers, SourceError for a file without a transform.
    """
    is_file = False
    # A text that is too long for a file name, or has a zero byte, is no file.
    with suppress(OSError, ValueError):
        is_file = Path(text.rpartition('#')[0] or text).is_file()
    return read_extrinsic(text).T_a_b if is_file else parse_transform(text)


def parse_transform(text: str) -> FloatArray:
    """Return the (4, 4) pose of six or seven numbers, separated by spaces or commas.

    ``x y z roll pitch yaw`` (metres, radians, as in URDF) or ``x y z qx qy qz qw``. Raises
    ConfigError for other text.
    """
    values = numbers_of(text)
    if values.shape not in ((6,), (7,)) or not np.isfinite(values).all():
        found = f' has {values.size} numbers,' if values.size else ':'
        raise ConfigError(
            f'transform {text!r}{found} needed x,y,z,roll,pitch,yaw (metres, radians, as in URDF) '
            'or x,y,z,qx,qy,qz,qw')
    if values.size == 6:
        return se3.from_rotation_translation(
            se3.rotation_from_roll_pitch_yaw(values[3:]), values[:3])
    norm = float(np.linalg.norm(values[3:]))
    if not abs(norm - 1) <= ROTATION_TOLERANCE:
        raise ConfigError(
            f'transform {text!r}: the quaternion has norm {norm:.4g}, needed 1; order x, y, z, w')
    return se3.from_rotation_translation(se3.quaternion_to_rotation(values[3:] / norm), values[:3])


def _rigid(matrix: FloatArray, file: Path) -> FloatArray:
    """Return the (4, 4) pose of a (4, 4) or (3, 4) matrix, checked, with an exact rotation."""
    if matrix.shape not in ((4, 4), (3, 4)) or not np.isfinite(matrix).all():
        raise SourceError(f'{file}: {matrix.shape} numbers, needed 4 x 4 or 3 x 4')
    R = matrix[:3, :3]
    last_row = matrix[3] if len(matrix) == 4 else np.eye(4)[3]
    off = np.abs(R.T @ R - np.eye(3)).max()
    if off > ROTATION_TOLERANCE or np.linalg.det(R) < 0 or not np.allclose(
            last_row, np.eye(4)[3], atol=1e-6):
        raise SourceError(
            f'{file}: the upper left 3 x 3 is no rotation (off by {off:.2g}), or the last row '
            'not 0 0 0 1; needed a rigid transform, row by row')
    # The nearest rotation removes the rounding of the file; an exact matrix is not changed.
    exact = R if off < 1e-14 else se3.nearest_rotation(R)
    return se3.from_rotation_translation(exact, matrix[:3, 3])


def _from_numbers(lines: list[str], file: Path) -> KnownExtrinsic:
    rows = list(map(numbers_of, lines))
    widths = [row.size for row in rows]
    if 0 in widths:
        raise SourceError(f'{file} holds no transform; needed {FORMS}')
    if widths in ([6], [7], [8]):
        # The first of eight numbers is a stamp.
        return KnownExtrinsic(_of_row(rows[0][widths == [8]:], file), f'one row, {_AS_POSE}')
    if widths in ([16], [12], [4] * 4, [4] * 3):
        form = 'matrix' if rows[1:] else 'one row of a matrix'
        return KnownExtrinsic(_rigid(np.concatenate(rows).reshape(-1, 4), file),
                              f'{form}, {_AS_POSE}')
    found = f'{counted(len(rows), "row")} of {widths[0]} numbers' if rows else 'no numbers'
    raise SourceError(f'{file} holds {found}, needed one transform: {FORMS}')


def _of_row(values: Iterable[float], file: Path) -> FloatArray:
    try:
        return parse_transform(' '.join(repr(float(value)) for value in values))
    except ConfigError as error:
        raise SourceError(f'{file}: {error}') from error


def _from_urdf(
    tree: FrameTree, key: str | None, frame_a: str | None, frame_b: str | None,
) -> KnownExtrinsic:
    if key is None and frame_a and frame_b and {frame_a, frame_b} <= tree.links:
        return KnownExtrinsic(tree.transform(frame_a, frame_b),
                              f'URDF, the pose of {frame_b} in {frame_a}')
    joints = {joint.name: joint for joint in tree.joints.values()}
    # A link can be given instead of its joint.
    name = tree.joints[key].name if key in tree.joints else key
    joint = _only(joints, name, tree.path, 'joint', 'JOINT',
                  ', or name the frames as the links are named')
    named = f'the pose of {joint.child} in {joint.parent}' if joint.child else 'origin'
    return KnownExtrinsic(joint.T_parent_child, f'URDF, {named}, {_AS_POSE}')


def _from_kitti(rows: Mapping[str, str], file: Path, key: str | None) -> KnownExtrinsic:
    """Read ``R:`` and ``T:``, ``R_02:`` and ``T_02:``, ``Tr:`` or ``Tr_velo_to_cam:``."""
    def values(name: str, *shape: int) -> FloatArray:
        found = numbers_of(rows[name])
        if found.size != np.prod(shape):
            raise SourceError(
                f'{file}: {name} has {found.size} numbers, needed {np.prod(shape)}')
        return found.reshape(shape)

    matrices = {}
    for name in rows:
        translation = f'T{name[1:]}'
        if name.startswith('Tr'):
            matrices[name] = values(name, 3, 4)
        # R_00 is the identity: camera 0 in camera 0.
        elif re.fullmatch(r'R(_\d+)?', name) and translation in rows and (key or name != 'R_00'):
            matrices[name[2:] or name] = np.hstack([values(name, 3, 3), values(translation, 3, 1)])
    matrix = _only(matrices, key, file,
                   more='; of a KITTI calib file R and T, R_02 and T_02, or Tr are read')
    return KnownExtrinsic(
        se3.inverse(_rigid(matrix, file)),
        'KITTI, which maps points of the first sensor to the second (calib_velo_to_cam: a velo, '
        'b cam); inverted to the pose of the second in the first')


def _from_mapping(
    data: Any, file: Path, key: str | None, frame_a: str | None, frame_b: str | None,
) -> KnownExtrinsic:
    if 'T_a_b' in data:
        values = [*data['T_a_b']['translation'], *data['T_a_b']['rotation_xyzw']]
        return KnownExtrinsic(
            _of_row(values, file),
            f'saved result, the pose of {data.get("frame_b")} in {data.get("frame_a")}')
    if 'T_parent_child' in data:
        return KnownExtrinsic(
            _rigid(np.array(data['T_parent_child'], dtype=np.float64), file),
            f'export, the pose of {data.get("child")} in {data.get("parent")}')
    cameras = {str(name): np.array(item['T_cn_cnm1'], dtype=np.float64)
               for name, item in data.items()
               if isinstance(item, Mapping) and 'T_cn_cnm1' in item}
    return (_from_kalibr(cameras, file, key) if cameras else
            _from_autoware(data, file, key, frame_a, frame_b))


def _from_kalibr(
    cameras: Mapping[str, FloatArray], file: Path, key: str | None,
) -> KnownExtrinsic:
    picked = _only({name: name for name in cameras}, key, file)
    T_last_first = np.eye(4)
    for name in sorted(cameras, key=lambda text: int(re.sub(r'\D', '', text) or 0)):
        T_last_first = _rigid(cameras[name], file) @ T_last_first
        if name == picked:
            break
    return KnownExtrinsic(
        se3.inverse(T_last_first),
        'Kalibr, whose T_cn_cnm1 maps points of the camera before to the next; inverted '
        f'to the pose of {picked} (b) in the first camera (a)')


def _from_autoware(
    data: Mapping[Any, Any], file: Path, key: str | None, frame_a: str | None,
    frame_b: str | None,
) -> KnownExtrinsic:
    found: dict[str, tuple[str, str, list[float]]] = {}
    for base, children in data.items():
        for child, pose in children.items():
            values = [float(pose[name]) for name in (*'xyz', 'roll', 'pitch', 'yaw')]
            # A child of two bases is named with its base.
            name = f'{base}/{child}' if child in found else str(child)
            found[name] = str(base), str(child), values
    if key is None and frame_b in found and found[frame_b][0] == frame_a:
        key = frame_b
    base, child, values = _only(found, key, file)
    return KnownExtrinsic(_of_row(values, file),
                          f'Autoware, the pose of {child} in {base}, taken as that of b in a')


def _only(
    found: Mapping[str, _T], key: str | None, file: Path, kind: str = 'transform',
    example: str = '', more: str = '',
) -> _T:
    """Return the item that ``#key`` picks, or the only one."""
    picked = [item for name, item in found.items() if key in (None, name)]
    if len(picked) == 1:
        return picked[0]
    names = f'#{example} to the file ({", ".join(found)})' if example else (
        f'#{" or #".join(found)} to the file')
    raise SourceError(
        f'{file} holds {counted(len(picked), kind)}{f" named {key}" if key else ""}, needed one'
        f'{f": append {names}" if found else ""}{more}')

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Why a pose does not enter a buffer."""

from __future__ import annotations

from enum import Enum
import math

from trajectory_calibration.data.trajectory import MAX_POSITION, ROTATION_TOLERANCE

# Position x, y, z (metres) and quaternion x, y, z, w.
PoseTuple = tuple[float, ...]


class Refusal(str, Enum):
    """Why a pose did not enter the buffer; the words of the diagnostics."""

    NO_STAMP = 'no stamp'
    NOT_FINITE = 'not finite'
    NOT_UNIT = 'not a unit quaternion'
    TOO_FAR = 'too far away'
    DUPLICATE = 'duplicate stamp'
    OUT_OF_ORDER = 'out of order'
    STRAY_STAMP = 'stray stamp'
    OTHER_FRAME = 'other frame'
    UNREADABLE = 'unreadable'
    EMPTY_PATH = 'path without a usable pose'


# Of these the unit is the message, not the pose.
OF_MESSAGES = (Refusal.UNREADABLE, Refusal.EMPTY_PATH)


def fault_of(pose: PoseTuple) -> Refusal | None:
    """Return why a pose is of no use, None where it is."""
    x, y, z, qx, qy, qz, qw = pose
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    # Written so that NaN fails.
    unit = abs(norm - 1.0) <= ROTATION_TOLERANCE
    if (unit and abs(x) <= MAX_POSITION and abs(y) <= MAX_POSITION
            and abs(z) <= MAX_POSITION):
        return None
    if not all(map(math.isfinite, pose)):
        return Refusal.NOT_FINITE
    return Refusal.TOO_FAR if unit else Refusal.NOT_UNIT

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Copies of a buffer, or of a part of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import counted, TrajectoryError
from trajectory_calibration.geometry.se3 import FloatArray

# A track of more poses is thinned.
_MANY_POSES = 20_000


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A copy of a buffer, cheap to send to another process.

    The (N, 7) poses are position x, y, z (metres) and quaternion x, y, z, w in the world frame;
    the warnings list the refused poses.
    """

    stamps_ns: NDArray[np.int64]
    poses: FloatArray
    world_frame: str
    sensor_frame: str
    warnings: tuple[str, ...] = ()

    def trajectory(self) -> Trajectory:
        """Return the poses as a Trajectory; raises TrajectoryError for fewer than two."""
        if len(self.stamps_ns) < 2:
            notes = ''.join(f'; {note}' for note in self.warnings)
            raise TrajectoryError(
                f'{self.sensor_frame}: {counted(len(self.stamps_ns), "pose")} received, needed at '
                f'least 2; check that the topic is published, and drive{notes}')
        return Trajectory.from_quaternions(
            self.stamps_ns, self.poses[:, :3], self.poses[:, 3:], self.world_frame,
            self.sensor_frame,
            tuple(Finding('input-repaired', note) for note in self.warnings))

    def thinned(self) -> Snapshot:
        """Return every n-th pose of a long track with a high rate; a short track unchanged.

        The standard deviations of a calibration change little, because accumulated errors are
        also in the remaining poses.
        """
        count = len(self.stamps_ns)
        if count <= _MANY_POSES:
            return self
        median_ns = max(int(np.median(np.diff(self.stamps_ns))), 1)
        # Steps of at most 0.1 s, for the interpolation and the estimate of the clock offset.
        stride = min(count // _MANY_POSES, 100_000_000 // median_ns)
        return self if stride < 2 else self._picked(slice(None, None, stride))

    def after(self, stamp_ns: int) -> Snapshot:
        """Return the poses after a stamp."""
        return self._picked(slice(int(np.searchsorted(self.stamps_ns, stamp_ns, 'right')), None))

    def _picked(self, part: slice) -> Snapshot:
        return replace(self, stamps_ns=self.stamps_ns[part], poses=self.poses[part])

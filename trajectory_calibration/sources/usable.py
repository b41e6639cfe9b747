# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which of the poses that a file or a topic holds can serve, and the trajectory they make."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding, texts
from trajectory_calibration.data.plausibility import lost_as_identity
from trajectory_calibration.data.trajectory import longest_run, Trajectory
from trajectory_calibration.errors import counted, SourceError, TrajectoryError
from trajectory_calibration.geometry.se3 import FloatArray


@dataclass(eq=False)
class UsablePoses:
    """Poses of which those go that cannot serve.

    Attributes
    ----------
    name : of the file or the topic, for messages.
    rows : what it holds, in words: 3 rows.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw; or (N, 4, 4) matrices.
    findings : what was repaired or left out.
    of_one : whether all of the poses are of one sensor; what goes is then said as a share.
    keep : (N,), which of them can serve.

    """

    name: str
    rows: str
    poses: FloatArray
    findings: list[Finding] = field(default_factory=list)
    of_one: bool = True

    def __post_init__(self) -> None:
        self.keep = np.ones(len(self.poses), dtype=bool)

    def drop(self, bad: NDArray[np.bool_], why: str, code: str = 'poses-lost') -> None:
        """Leave out some of the (N,) poses, and say ``why``."""
        count = int(np.count_nonzero(bad & self.keep))
        if count:
            share = f'{count:,} of ' if self.of_one else ''
            poses = counted(len(self.keep) if self.of_one else count, 'pose')
            self.findings.append(Finding(code, f'dropped {share}{poses}{why}', {'poses': count}))
        self.keep &= ~bad

    def to_trajectory(
        self, stamps_ns: NDArray[np.int64], world: str, sensor: str,
        advice: str = 'write them with nine decimals (%.9f)',
    ) -> Trajectory:
        """Make a trajectory of the poses at their (N,) times, without those a lost SLAM wrote.

        Raise SourceError where too few are left, or many share their time; ``advice`` mends that.
        """
        lost = np.zeros(len(self.keep), dtype=bool)
        lost[self.keep] = lost_as_identity(self.poses[self.keep])
        self.drop(lost, ': identity, far from the neighbours (the SLAM was lost?)')
        stamps_ns, poses = stamps_ns[self.keep], self.poses[self.keep]
        if len(poses) < 2:
            because = f' ({"; ".join(texts(self.findings))})' if self.findings else ''
            raise SourceError(
                f'{self.name}: poses in {len(poses)} of {self.rows}, needed at least 2{because}; '
                'record while the sensor moves and its SLAM tracks')
        _require_own_stamps(stamps_ns, poses, self.name, advice)
        findings = tuple(replace(item, text=f'{sensor}: {self.name}: {item.text}')
                         for item in self.findings)
        try:
            return (Trajectory(stamps_ns, poses, world, sensor, findings) if poses.ndim == 3 else
                    Trajectory.from_quaternions(
                        stamps_ns, poses[:, :3], poses[:, 3:], world, sensor, findings))
        except TrajectoryError as error:
            raise SourceError(f'{self.name}: {error}') from error


def _require_own_stamps(
    stamps_ns: NDArray[np.int64], poses: FloatArray, name: str, advice: str,
) -> None:
    """Raise SourceError where many poses share their time with another pose.

    ``poses`` are (N, ...) numbers. Rows that are repeated as a whole are harmless.
    """
    run = longest_run(stamps_ns)
    stamps_ns, poses = stamps_ns[run], poses[run]
    count = len(stamps_ns)
    if (stamps_ns[1:] > stamps_ns[:-1]).all():
        return
    order = np.argsort(stamps_ns, kind='stable')
    ordered, rows = stamps_ns[order], poses[order].reshape(count, -1)
    shared = (ordered[1:] == ordered[:-1]) & (rows[1:] != rows[:-1]).any(axis=1)
    found = int(np.count_nonzero(shared))
    if found < 2 or found <= 0.1 * count:
        return
    distinct = np.unique(stamps_ns)
    if len(distinct) == 1:
        raise SourceError(
            f'{name}: all {counted(count, "pose")} have the same time, {distinct[0] * 1e-9:.9g} '
            f's; needed the time of each pose, not rounded: {advice}')
    step = int(np.gcd.reduce(np.diff(distinct))) * 1e-9
    digits = len(f'{abs(int(distinct[0])) * 1e-9 / step:.0f}')
    raise SourceError(
        f'{name}: {found:,} of {counted(count, "pose")} share their time with another: two '
        f'sensors in one, or the times are rounded to {step:.3g} s ({digits} digits); {advice}')

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Drop the unusable poses of a file or a topic, and make a trajectory of the others."""

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
    """Poses, and which of them are usable.

    Attributes
    ----------
    name : of the file or the topic, for messages.
    rows : number of rows in words, '3 rows', for messages.
    poses : (N, 7), x, y, z (m), qx, qy, qz, qw; or (N, 4, 4) matrices.
    findings : repairs and dropped poses.
    of_one : whether all poses are of one sensor, so that findings give N as well.
    keep : (N,), which poses are usable.

    """

    name: str
    rows: str
    poses: FloatArray
    findings: list[Finding] = field(default_factory=list)
    of_one: bool = True

    def __post_init__(self) -> None:
        self.keep = np.ones(len(self.poses), dtype=bool)

    def drop(self, bad: NDArray[np.bool_], why: str, code: str = 'poses-lost') -> None:
        """Drop the poses of the (N,) mask, and add a finding with the reason ``why``."""
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
        """Return the trajectory of the usable poses; ``stamps_ns`` are (N,).

        Identities that a lost SLAM wrote are dropped, too. Raise SourceError if fewer than two
        poses are left, or many have equal times; ``advice`` is the remedy for equal times.
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
    """Raise SourceError if many poses have the time of another, different pose.

    ``poses`` are (N, ...) numbers. Exact duplicates of a row are harmless.
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

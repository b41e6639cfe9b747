# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""How far and how much the sensors move from a reference to the current pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.paper.kitti import paper_pairs
from benchmarks.paper.published import read_kitti, SEQUENCES
from benchmarks.paper.statistics import quartiles
from benchmarks.paper.tasks import REFERENCES, Task
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.geometry import se3
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation


@dataclass(frozen=True)
class MotionSizes:
    """Medians and quartiles over the motions of sensor a at one reference.

    The fields are the columns of ``motions.csv``.
    """

    data: str
    reference: str
    motions: int
    distance_q25_m: float
    distance_median_m: float
    distance_q75_m: float
    angle_q25_deg: float
    angle_median_deg: float
    angle_q75_deg: float


def sizes_of_runs(source: str, tasks: Iterable[Task]) -> list[MotionSizes]:
    """Measure the base trajectories of a source, which are its runs without noise, together."""
    pairs = []
    for task in tasks:
        if (task.source, task.kind, task.level) == (source, 'noise', 0):
            a, b, _ = task.load()
            pairs.append(associate_by_interpolation(a, b, max_gap_ns=None))
    return _measure(source, pairs) if pairs else []


def sizes_of_kitti(data: Path) -> list[MotionSizes]:
    """Measure both drives."""
    drives = {sequence[:10]: read_kitti(data, sequence) for sequence in SEQUENCES}
    return [row for name, drive in drives.items()
            for row in _measure(name, [paper_pairs(drive.a, drive.b)])]


def _measure(name: str, pairs: list[PosePairs]) -> list[MotionSizes]:
    rows = []
    for reference in REFERENCES:
        A = np.concatenate([select_motions(item, reference).A for item in pairs])
        rows.append(MotionSizes(
            name, reference, len(A), *quartiles(np.linalg.norm(A[:, :3, 3], axis=1)),
            *quartiles(np.rad2deg(se3.rotation_angle(A[:, :3, :3])))))
    return rows

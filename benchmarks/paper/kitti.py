# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The two KITTI drives, by the paper's protocol."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.published import kitti_figures, read_kitti, SEQUENCES
from benchmarks.paper.tasks import PAPER_SOLVERS, REFERENCES
from trajectory_calibration.assessment.metrics import absolute_errors, relative_errors
from trajectory_calibration.assessment.observability import translation_gain
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.interpolation import left_of
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.time_alignment.pairing import associate_by_interpolation

# The c that the paper states, and the c that its published tables were made with.
STATED_C, PUBLISHED_C = 0.01, 1e-4

# The axis that the drive determines least is told from motions long enough to turn.
_AXIS_REFERENCE = 'B10'


class KittiTask(NamedTuple):
    """One drive at one reference, for some of the paper's solvers."""

    data: Path
    sequence: str
    reference: str
    solvers: tuple[str, ...] = PAPER_SOLVERS


@dataclass(frozen=True)
class KittiRecord:
    """One calibration of a drive. The fields are the columns of ``kitti.csv``.

    ``published_*`` are the paper's errors of that solver and reference, which for dnlo were made
    with ``PUBLISHED_C``. ``along_m`` and ``across_m`` split the translation error along and across
    the axis that the drive determines least. ``corrected_*`` are errors against the truth of
    rectified cameras; those of 2011_09_30, whose file is right, repeat the others.
    """

    sequence: str
    solver: str
    dnlo_c: float
    reference: str
    e_rt_m: float
    e_rR_deg: float
    e_at_m: float
    e_aR_deg: float
    published_e_rt_m: float
    published_e_rR_deg: float
    published_e_at_m: float
    published_e_aR_deg: float
    along_m: float
    across_m: float
    corrected_e_at_m: float
    corrected_e_aR_deg: float
    corrected_along_m: float
    corrected_across_m: float

    @property
    def errors(self) -> tuple[float, float, float, float]:
        """Return the four errors in the order of ``published.ERRORS``."""
        return self.e_rt_m, self.e_rR_deg, self.e_at_m, self.e_aR_deg

    @property
    def published(self) -> tuple[float, float, float, float]:
        """Return the paper's four errors, in the same order."""
        return (self.published_e_rt_m, self.published_e_rR_deg,
                self.published_e_at_m, self.published_e_aR_deg)


def kitti_tasks(data: Path, solvers: Collection[str]) -> list[KittiTask]:
    """Return both drives at every reference, for those of the solvers that the paper has."""
    of_paper = tuple(name for name in PAPER_SOLVERS if name in solvers)
    if not of_paper:
        return []
    return [KittiTask(data, sequence, reference, of_paper)
            for sequence in SEQUENCES for reference in REFERENCES]


def paper_pairs(a: Trajectory, b: Trajectory) -> PosePairs:
    """Return the pairs of the paper's protocol.

    Sensor a is interpolated along geodesics over any gap and continued past its end: what
    published tables need, and nothing else should do.
    """
    summary = associate_by_interpolation(a, b, max_gap_ns=None).summary
    left = left_of(a.stamps_ns, b.stamps_ns)
    start_ns, end_ns = a.stamps_ns[left], a.stamps_ns[left + 1]
    poses_a = se3.geodesic(
        a.poses[left], a.poses[left + 1], (b.stamps_ns - start_ns) / (end_ns - start_ns))
    return PosePairs(b.stamps_ns, poses_a, b.poses, replace(summary, pairs=len(b)))


def run_kitti_task(task: KittiTask) -> list[KittiRecord]:
    """Calibrate one drive at one reference by the task's solvers."""
    drive = read_kitti(task.data, task.sequence)
    pairs = paper_pairs(drive.a, drive.b)
    motions = select_motions(pairs, task.reference)
    axis = translation_gain(select_motions(pairs, _AXIS_REFERENCE).A[:, :3, :3])[1][0]
    figures = kitti_figures(task.data)
    records = []
    for solver in task.solvers:
        for c in (PUBLISHED_C, STATED_C) if solver == 'dnlo' else (STATED_C,):
            config = CalibrationConfig(solver=solver, dnlo_c=c, dnlo_method='ipopt')
            T_a_b = load_solver(solver)(motions, config).T_a_b
            relative = relative_errors(T_a_b, motions)
            records.append(KittiRecord(
                task.sequence, solver, c, task.reference,
                relative.e_rt, float(np.rad2deg(relative.e_rR)),
                *_absolute(T_a_b, drive.T_a_b_file),
                *figures[task.sequence, solver, task.reference],
                *_split(T_a_b, drive.T_a_b_file, axis),
                *_absolute(T_a_b, drive.T_a_b_corrected),
                *_split(T_a_b, drive.T_a_b_corrected, axis)))
    return records


def _absolute(T_a_b: FloatArray, T_a_b_true: FloatArray) -> tuple[float, float]:
    found = absolute_errors(T_a_b, T_a_b_true)
    return found.e_at, float(np.rad2deg(found.e_aR))


def _split(T_a_b: FloatArray, T_a_b_true: FloatArray, axis: FloatArray) -> tuple[float, float]:
    """Return the translation error along a (3,) unit axis in a and across it, metres."""
    error = T_a_b[:3, 3] - T_a_b_true[:3, 3]
    along = float(error @ axis)
    return abs(along), float(np.linalg.norm(error - along * axis))

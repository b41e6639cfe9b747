# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The pipeline from two trajectories to an extrinsic, one stage per line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict

from trajectory_calibration.assessment.answer_checks import check_answer
from trajectory_calibration.assessment.covariance import estimate_uncertainty
from trajectory_calibration.assessment.input_checks import (
    check_orientations,
    check_pairs,
    orientation_jumps,
    require_fit,
    short_drive,
)
from trajectory_calibration.assessment.metrics import relative_errors
from trajectory_calibration.assessment.observability import observe, require_motion_beyond_noise
from trajectory_calibration.assessment.prior_update import apply_prior, contradictions
from trajectory_calibration.assessment.reference_selection import choose_reference
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.data.held import without_held
from trajectory_calibration.data.motion_pairs import select_motions
from trajectory_calibration.data.plausibility import (
    position_doubts,
    time_doubts,
    unit_doubts,
)
from trajectory_calibration.data.pose_pairs import AssociationSummary
from trajectory_calibration.data.trajectory import recording_of, Trajectory
from trajectory_calibration.errors import MotionError, SolverError, TrajectoryError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.solvers import load_solver
from trajectory_calibration.solvers.solution import Solver
from trajectory_calibration.time_alignment.align import match
from trajectory_calibration.time_alignment.clock_offset import in_total
from trajectory_calibration.time_alignment.pairing import association_findings, UNPAIRED_SHARE


def calibrate(
    trajectory_a: Trajectory,
    trajectory_b: Trajectory,
    config: CalibrationConfig | None = None,
) -> CalibrationResult:
    """Estimate the extrinsic between two sensors from their trajectories.

    Parameters
    ----------
    trajectory_a, trajectory_b : Trajectory
        Of the parent sensor a and of the child sensor b.
    config : CalibrationConfig, optional
        Settings; the defaults where omitted.

    Returns
    -------
    CalibrationResult
        With ``T_a_b``, the pose of sensor b in sensor a.

    Raises
    ------
    CalibrationError
        One of its subclasses: AssociationError (no common time), MotionError (no motion, or
        trajectories that do not belong together), SolverError (no minimum found), ConfigError,
        TrajectoryError (an argument is no trajectory).

    """
    for name, given in (('trajectory_a', trajectory_a), ('trajectory_b', trajectory_b)):
        if not isinstance(given, Trajectory):
            raise TrajectoryError(
                f'{name} is of type {type(given).__name__}, needed a Trajectory; build one from '
                'stamps and poses, or load a file with FileSource')
    config = config or CalibrationConfig()
    solve: Solver = load_solver(config.solver)
    frames = trajectory_a.sensor_frame, trajectory_b.sensor_frame
    recording = recording_of(trajectory_a, trajectory_b)
    trajectory_a, held_a = without_held(trajectory_a)
    trajectory_b, held_b = without_held(trajectory_b.scaled(config.scale))
    check_orientations(trajectory_a, trajectory_b, config)
    clock, pairs = match(trajectory_a, trajectory_b, config)
    # The speed of b is not checked: a monocular camera has an arbitrary unit.
    doubts = (*held_a, *held_b, *time_doubts(trajectory_a), *time_doubts(trajectory_b),
              *position_doubts(trajectory_a))
    matched = (*association_findings(pairs, trajectory_a, trajectory_b),
               *clock.findings(config.time_offset, trajectory_b.sensor_frame,
                               trajectory_b.duration_s))
    with _with_findings((*doubts, *(matched if _poorly_matched(pairs.summary) else ()))):
        questions = check_pairs(pairs, trajectory_a, trajectory_b, clock, config)
        choice = choose_reference(pairs, config)
        motions = select_motions(pairs, choice.reference)
        solution = solve(motions, config)
        if config.input_checks:
            require_fit(solution.T_a_b, pairs, frames, config.solver)
        uncertainty = estimate_uncertainty(solution, motions, config, choice.known)
        T_a_b, covariance = apply_prior(solution.T_a_b, uncertainty.covariance, config.prior)
        answer_doubts = check_answer(
            solution.T_a_b, uncertainty.covariance, pairs.scaled(solution.scale), frames, config)
        metrics = relative_errors(T_a_b, motions.scaled(solution.scale))
        observability = observe(
            motions, uncertainty.covariance, covariance, config, trajectory_a.sensor_frame)
        require_motion_beyond_noise(
            observability, solution.T_a_b, pairs.scaled(solution.scale))
    return CalibrationResult(
        frame_a=trajectory_a.sensor_frame,
        frame_b=trajectory_b.sensor_frame,
        T_a_b=T_a_b,
        covariance=covariance,
        metrics=metrics,
        poses=len(pairs),
        motions=len(motions),
        inliers=solution.inliers,
        observability=observability,
        association=pairs.summary,
        config=config,
        reference=motions.reference,
        reference_choice=choice.explanation or None,
        optimality_gap=solution.optimality_gap,
        scale=config.scale * solution.scale,
        time_offset_s=pairs.summary.time_offset_s + solution.time_offset_s,
        clock_drift=clock.drift,
        clock_drift_from_ns=clock.drift_from_ns,
        start_ns=int(pairs.stamps_ns[0]),
        duration_s=float(pairs.stamps_ns[-1] - pairs.stamps_ns[0]) * 1e-9,
        recording=recording,
        diagnosis=None if solution.diagnosis is None else asdict(solution.diagnosis),
        findings=worst_first(in_total(
            clock.offset_s - config.time_offset, solution.time_offset_s, (
                *trajectory_a.findings,
                *trajectory_b.findings,
                *doubts,
                *matched,
                *questions,
                *unit_doubts(solution.scale, trajectory_a.sensor_frame),
                *short_drive(pairs, metrics),
                *answer_doubts,
                *(orientation_jumps(pairs) if solution.diagnosis is None else ()),
                *solution.findings,
                *contradictions(solution.T_a_b, uncertainty.covariance, config.prior),
                *uncertainty.findings,
                *observability.findings,
            ))),
    )


@contextmanager
def _with_findings(found: Sequence[Finding]) -> Iterator[None]:
    """Append findings about the input to an error that they may explain."""
    try:
        yield
    except (MotionError, SolverError) as error:
        if found:
            error.args = (f'{error}. Also found: {"; ".join(map(str, found))}',)
        raise


def _poorly_matched(summary: AssociationSummary) -> bool:
    """Return whether there are few pairs or many unpaired poses."""
    count = summary.poses_b if summary.stamps_of == 'b' else summary.poses_a
    unpaired = max(summary.in_gaps, summary.outside) / count
    return summary.pairs < 30 or unpaired > UNPAIRED_SHARE

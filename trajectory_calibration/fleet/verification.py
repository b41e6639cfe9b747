# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Test whether a saved extrinsic still holds on other data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from trajectory_calibration.assessment.observability import (
    DEGREES_OF_FREEDOM,
    Observability,
    UNOBSERVED,
)
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.trajectory import recording_of, Trajectory
from trajectory_calibration.errors import AssociationError, MotionError, ResultError, SolverError
from trajectory_calibration.exit_status import CHANGED, DONE, INCOMPLETE
from trajectory_calibration.fleet.differences import (
    AXES,
    describe_step,
    Difference,
    difference,
    in_units,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult

HOLDS, CANNOT_TELL, MOVED = 'holds', 'cannot tell', 'moved'

_EXIT_STATUS = {HOLDS: DONE, CANNOT_TELL: INCOMPLETE, MOVED: CHANGED}

# Status of an axis that is unobservable in the saved result: there is nothing to verify.
NOT_KNOWN = 'not in the result'

# Findings of data that can neither confirm nor contradict an extrinsic.
_NO_EVIDENCE = {'orientations-identical', 'poses-identical', 'worlds-differ'}


@dataclass(frozen=True, eq=False)
class Verification:
    """The verdict on a saved extrinsic.

    Attributes
    ----------
    verdict : 'holds', 'cannot tell' or 'moved'.
    status : by degree of freedom: one of these, or 'not in the result' if it is unobservable
        in the saved result.
    difference : the step from the saved extrinsic to the new one; None without a new one.
    needs : what another drive must contain for a verdict; empty if there is a verdict.
    result : the calibration of the new data alone, without priors, or None.
    notes : sentences about the comparison.

    """

    verdict: str
    status: dict[str, str]
    difference: Difference | None
    needs: str
    result: CalibrationResult | None
    notes: tuple[str, ...] = ()

    @property
    def exit_status(self) -> int:
        """Return 0 if every direction holds, 4 for moved, 3 if a direction was not tested."""
        if self.verdict == HOLDS and NOT_KNOWN in self.status.values():
            return INCOMPLETE
        return _EXIT_STATUS[self.verdict]

    def describe(self) -> str:
        """Return the verdict in one sentence."""
        step = self.difference
        if self.verdict == MOVED and step is not None:
            return f'moved by {step.describe()}'
        held, untested, not_known = (
            [name for name, status in self.status.items() if status == each]
            for each in (HOLDS, CANNOT_TELL, NOT_KNOWN))
        if self.verdict == CANNOT_TELL and step is None:
            return f'cannot tell: {self.needs}'
        if self.verdict == CANNOT_TELL:
            others = f'; {", ".join(held)} hold' if held else ''
            return f'cannot tell {", ".join(untested)} (needs: {self.needs}){others}'
        sentence = f'holds in {len(held)} of 6 directions' if not_known else HOLDS
        weak = [] if step is None else [
            axis for axis, name, is_weak in zip(AXES, DEGREES_OF_FREEDOM, step.weak, strict=True)
            if is_weak and name in held]
        if weak:
            sentence += f', weakly tested {", ".join(weak)}'
        if not_known:
            sentence += f'; not tested: {", ".join(not_known)} (not in the saved result)'
        return sentence

    def describe_resolution(self) -> str:
        """Return the smallest detectable shift along each tested axis."""
        if self.difference is None:
            return ''
        return describe_step(self.difference.resolution, [
            k for k, name in enumerate(DEGREES_OF_FREEDOM)
            if self.difference.testable[k] and self.status[name] != NOT_KNOWN], sign='-')

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        step = self.difference
        return {
            'verdict': self.verdict,
            'sentence': self.describe(),
            'exit_status': self.exit_status,
            'status': dict(self.status),
            'needs': self.needs,
            'difference': None if step is None else step.to_dict(),
            'resolution': None if step is None else in_units('', step.resolution),
            'notes': list(self.notes),
            'result': None if self.result is None else self.result.to_dict(),
        }


def verify(
    result: CalibrationResult,
    trajectory_a: Trajectory,
    trajectory_b: Trajectory,
    config: CalibrationConfig | None = None,
) -> Verification:
    """Calibrate other data of the same sensors, and compare the extrinsics.

    Parameters
    ----------
    result : CalibrationResult
        The saved result.
    trajectory_a, trajectory_b : Trajectory
        Of the same sensors, on another drive.
    config : CalibrationConfig, optional
        Settings of the new calibration; by default those of ``result``. Priors are not used: a
        component with a prior would confirm itself.

    Returns
    -------
    Verification
        'cannot tell', not an error, if the data give no answer, or if ``result`` was calibrated
        from the same recording.

    Raises
    ------
    ResultError
        The saved result has no covariance, or A and B are exchanged: by their frames, or because
        the new answer is the inverse of the saved one.

    """
    if result.covariance is None:
        raise ResultError('the saved result has no covariance to compare with; calibrate again')
    frames = trajectory_a.sensor_frame, trajectory_b.sensor_frame
    if frames == (result.frame_b, result.frame_a) and frames[0] != frames[1]:
        raise ResultError(f'the data are of {frames[0]} and {frames[1]}, the saved result of '
                          f'{result.frame_a} and {result.frame_b}; exchange A and B')
    notes = () if frames == (result.frame_a, result.frame_b) else (
        f'data of {" and ".join(frames)}, saved result of {result.frame_a} and {result.frame_b}',)
    status = {
        name: NOT_KNOWN if result.observability.status[name] == UNOBSERVED else CANNOT_TELL
        for name in DEGREES_OF_FREEDOM}

    def cannot_tell(needs: str) -> Verification:
        return Verification(CANNOT_TELL, status, None, needs, None, notes)

    if result.recording == recording_of(trajectory_a, trajectory_b):
        return cannot_tell('the saved result was made of this recording; give another one')
    config = replace(
        config or CalibrationConfig.from_dict(result.config.to_dict()), allow_unobserved=True,
        prior_translation='', prior_translation_std='', prior_rotation='', prior_rotation_std='')
    try:
        new_result = calibrate(trajectory_a, trajectory_b, config)
    except (AssociationError, MotionError, SolverError) as error:
        return cannot_tell(str(error))
    reasons = [finding.text for finding in new_result.findings if finding.code in _NO_EVIDENCE]
    if new_result.covariance is None or reasons:
        return cannot_tell(' '.join(reasons) or 'the solver gave no covariance')
    old = result.T_a_b, result.covariance
    new = new_result.T_a_b, new_result.covariance
    step = difference(old, new, config)
    if step.differs and _is_inverse(old, new, config):
        raise ResultError(
            'are A and B exchanged? The new answer is the inverse of the saved one. Give first '
            f'the trajectory of {result.frame_a}, then that of {result.frame_b}')
    for k, name in enumerate(DEGREES_OF_FREEDOM):
        if step.differs and k in step.named:
            status[name] = MOVED
        elif step.testable[k] and status[name] != NOT_KNOWN:
            status[name] = HOLDS
    # An empty set is no confirmation: the saved result may have no observable direction.
    verdict = (MOVED if step.differs else
               HOLDS if {*status.values()} - {NOT_KNOWN} == {HOLDS} else CANNOT_TELL)
    needs = '' if verdict != CANNOT_TELL else _needs(new_result.observability)
    return Verification(verdict, status, step, needs, new_result, notes)


def _is_inverse(
    old: tuple[FloatArray, FloatArray], new: tuple[FloatArray, FloatArray],
    config: CalibrationConfig,
) -> bool:
    """Return whether the inverse of the old extrinsic fits in more than one direction."""
    J = se3.inverse_step(old[0])
    step = difference((se3.inverse(old[0]), J @ old[1] @ J.T), new, config)
    return step.degrees_of_freedom > 1 and not step.differs


def _needs(observability: Observability) -> str:
    """Return what the motion lacked."""
    if observability.hardly_turned:
        return 'curves, and a ramp or a bank: the vehicle hardly turned'
    if observability.single_axis:
        return 'turns about another axis, as on a ramp or a bank'
    return 'a longer drive, or sharper turns'

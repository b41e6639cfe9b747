# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Which directions of an extrinsic the motion determined, from its covariance.

A direction is unobservable if its standard deviation exceeds a limit. The limits are settings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from trajectory_calibration.assessment.excitation import split_pairs
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding, texts
from trajectory_calibration.data.motion_pairs import MotionPairs
from trajectory_calibration.data.pose_pairs import PosePairs
from trajectory_calibration.errors import counted, MotionError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray

# Degrees of freedom in the order of the covariance; axes are those of sensor a.
DEGREES_OF_FREEDOM = ('x', 'y', 'z', 'rotation x', 'rotation y', 'rotation z')

OBSERVED, WEAK, UNOBSERVED, PRIOR = 'observed', 'weak', 'unobserved', 'prior'

# Within this angle of an axis, a direction is called by the name of the axis.
_NEAR_AXIS = np.cos(np.deg2rad(18.0))

# How to improve a weak direction.
_MORE = {'translation': 'Drive tighter curves, steeper ramps, or longer',
         'rotation': 'Drive more curves, ramps and banks, or longer'}

_UNITS = {'translation': 'm', 'rotation': 'deg'}


@dataclass(frozen=True)
class WeakAxis:
    """A direction of the extrinsic that is weak or unobserved.

    Attributes
    ----------
    kind : 'translation' or 'rotation'.
    axis : unit vector in a: of the translation along it, or the rotation about it.
    std : standard deviation, metres or degrees.
    status : 'weak' or 'unobserved'.

    """

    kind: str
    axis: tuple[float, ...]
    std: float
    status: str


@dataclass(frozen=True)
class Observability:
    """Observability of each direction of the extrinsic; axes are those of sensor a.

    Attributes
    ----------
    status : of each degree of freedom: 'observed', 'weak', 'unobserved', or 'prior' if the value
        comes from the prior.
    weak_axes : weak and unobservable directions: translations, then rotations, each with the
        largest standard deviation first.
    excitation_deg : root mean square rotation of a motion about x, y, z of a, degrees.
    translation_gain : three numbers, ascending: metres of residual, root mean square over the
        motions, per metre of error of the translation along each of ``translation_axes``.
    translation_axes : three unit vectors in a, weakest first.
    single_axis : unit vector in a, if the motion rotated about one axis only; else empty.
    findings : on the weak and unobservable directions.

    """

    status: dict[str, str]
    weak_axes: tuple[WeakAxis, ...]
    excitation_deg: tuple[float, ...]
    translation_gain: tuple[float, ...]
    translation_axes: tuple[tuple[float, ...], ...]
    single_axis: tuple[float, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def hardly_turned(self) -> bool:
        """Return whether the rotations are no larger than noise, 0.2 deg root mean square."""
        return bool(np.linalg.norm(self.excitation_deg) < 0.2)

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Return the degrees of freedom that neither motion nor prior determine."""
        return tuple(name for name, status in self.status.items() if status == UNOBSERVED)

    @property
    def weak(self) -> tuple[str, ...]:
        """Return the degrees of freedom that are weak."""
        return tuple(name for name, status in self.status.items() if status == WEAK)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the texts of the findings."""
        return texts(self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON or YAML."""
        return {
            'status': dict(self.status),
            'weak_axes': [{**asdict(item), 'axis': list(item.axis)} for item in self.weak_axes],
            'excitation_deg': list(self.excitation_deg),
            'translation_gain': list(self.translation_gain),
            'translation_axes': [list(axis) for axis in self.translation_axes],
            'single_axis': list(self.single_axis),
            'warnings': [found.text for found in self.findings],
        }

    @classmethod
    def from_dict(
        cls, data: dict[str, Any], findings: Iterable[Finding] = (),
    ) -> Observability:
        """Rebuild from ``to_dict`` and the findings, which a result stores separately."""
        return cls(
            {name: str(data['status'][name]) for name in DEGREES_OF_FREEDOM},
            tuple(WeakAxis(str(item['kind']), _floats(item['axis']), float(item['std']),
                           str(item['status'])) for item in data['weak_axes']),
            _floats(data['excitation_deg']),
            _floats(data['translation_gain']),
            tuple(map(_floats, data['translation_axes'])),
            _floats(data.get('single_axis', ())),
            tuple(findings))


def _floats(values: Iterable[Any]) -> tuple[float, ...]:
    return tuple(map(float, values))


def observe(
    motions: MotionPairs,
    by_motion: FloatArray,
    covariance: FloatArray,
    config: CalibrationConfig,
    frame: str,
) -> Observability:
    """Return the observability of an extrinsic.

    ``by_motion`` and ``covariance`` are the (6, 6) covariances of the extrinsic from the motion
    alone and with the prior; ``frame`` is the name of sensor a in the findings.
    """
    R = motions.A[:, :3, :3]
    excitation = np.rad2deg(np.sqrt(np.mean(se3.log_so3(R) ** 2, axis=0)))
    gain, axes = translation_gain(R)
    found = Observability(
        _status(by_motion, covariance, config),
        _weak_axes(covariance, config),
        tuple(excitation.tolist()),
        tuple(gain.tolist()),
        tuple(tuple(axis) for axis in axes.tolist()),
        _single_axis(motions))
    return replace(found, findings=_describe(found, frame))


def require_motion_beyond_noise(
    observability: Observability, T_a_b: FloatArray, pairs: PosePairs,
) -> None:
    """Raise MotionError if the pairs contain no motion, as of a stationary vehicle.

    One observed direction is an answer; the others are flagged. If there is none, whatever the
    limits of the user, the motion itself is tested.
    """
    # By eigenvectors: one unobservable direction oblique to all axes would hide the others.
    blind = [item for item in observability.weak_axes if item.status == UNOBSERVED]
    if len(blind) < len(DEGREES_OF_FREEDOM):
        return
    if len(split_pairs(T_a_b, pairs).unobserved) == len(DEGREES_OF_FREEDOM):
        raise MotionError(
            f'no motion beyond the noise in {counted(len(pairs), "pose pair")}: no direction of '
            'the extrinsic is known. A stationary vehicle cannot be calibrated: drive curves, and '
            'a ramp or a bank')


def translation_gain(rotations_a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (3,) ascending gains of ``(R_A - I) t`` and the (3, 3) axes as rows.

    ``rotations_a`` is (M, 3, 3); the gain is the root mean square over the motions. The weakest
    axis is the main rotation axis of the sensor.
    """
    D = rotations_a - np.eye(3)
    eigenvalues, eigenvectors = np.linalg.eigh(
        np.einsum('kij,kil->jl', D, D) / max(1, len(rotations_a)))
    return np.sqrt(np.maximum(eigenvalues, 0.0)), _pointed(eigenvectors.T)


def axis_name(axis: FloatArray) -> str:
    """Return 'x', 'y' or 'z' for a (3,) unit vector near one of them, else its components."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > _NEAR_AXIS:
        return 'xyz'[largest]
    return f'({", ".join(f"{value:.2f}" for value in axis)})'


def _single_axis(motions: MotionPairs) -> tuple[float, ...]:
    """Return the axis in a of all rotations that both sensors measured, if there is only one.

    The rotation about any other axis is then below a fifth of it, root mean square.
    """
    turn_a, turn_b = (se3.log_so3(moved[:, :3, :3]) for moved in (motions.A, motions.B))
    shared = turn_a.T @ turn_b
    # In the axes of a the product is symmetric.
    squares, axes = np.linalg.eigh(shared @ se3.nearest_rotation(shared).T)
    return tuple(_pointed(axes.T)[2].tolist()) if squares[1] <= 0.2**2 * squares[2] else ()


def limits_of(config: CalibrationConfig) -> FloatArray:
    """Return the (6,) limits, metres and radians, beyond which a direction is unobserved."""
    return np.repeat([max(config.unobserved_translation, 1e-3),
                      max(np.deg2rad(config.unobserved_rotation), 1e-3)], 3)


def status_of(config: CalibrationConfig, std: float, *, rotation: bool) -> str:
    """Return the status of a standard deviation, metres or degrees."""
    weak, unobserved = (
        (config.weak_rotation, config.unobserved_rotation) if rotation else
        (config.weak_translation, config.unobserved_translation))
    # NaN is unobserved.
    if not std <= unobserved:
        return UNOBSERVED
    return OBSERVED if std <= weak else WEAK


def _pointed(axes: FloatArray) -> FloatArray:
    """Choose the signs of (3, 3) axes (rows) so that their largest component is positive."""
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], axis=1)
    pointed: FloatArray = axes * np.sign(largest)
    return pointed


def deviations_of(covariance: FloatArray) -> FloatArray:
    """Return (6,) standard deviations, metres and degrees."""
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return np.concatenate([std[:3], np.rad2deg(std[3:])])


def _status(
    by_motion: FloatArray, covariance: FloatArray, config: CalibrationConfig,
) -> dict[str, str]:
    before, after = deviations_of(by_motion), deviations_of(covariance)
    given = np.isfinite(config.prior.std)
    status = {}
    for k, name in enumerate(DEGREES_OF_FREEDOM):
        status[name] = status_of(config, after[k], rotation=k >= 3)
        # A value comes from the prior if the prior halves its variance. A prior of one component
        # improves others through their correlation: these do so only if the motion alone did not
        # determine them.
        doubtful = given[k] or status_of(config, before[k], rotation=k >= 3) != OBSERVED
        dominated = after[k]**2 < 0.5 * before[k]**2
        if dominated and doubtful and status[name] != UNOBSERVED:
            status[name] = PRIOR
    return status


def _weak_axes(covariance: FloatArray, config: CalibrationConfig) -> tuple[WeakAxis, ...]:
    found = []
    for kind, block in (('translation', covariance[:3, :3]), ('rotation', covariance[3:, 3:])):
        rotation = kind == 'rotation'
        variances, axes = np.linalg.eigh(block)
        for variance, axis in zip(variances[::-1], _pointed(axes.T)[::-1], strict=True):
            std = float(np.sqrt(max(variance, 0.0)))
            std = float(np.rad2deg(std)) if rotation else std
            status = status_of(config, std, rotation=rotation)
            if status != OBSERVED:
                found.append(WeakAxis(kind, tuple(axis.tolist()), std, status))
    return tuple(found)


def _describe(observed: Observability, frame: str) -> tuple[Finding, ...]:
    """Return the findings: one for all directions with the same cause."""
    single = np.array(observed.single_axis or (0.0, 0.0, 0.0))
    causes: dict[tuple[str, str], list[WeakAxis]] = {}
    for item in observed.weak_axes:
        if item.status == WEAK:
            why = _MORE[item.kind]
        elif observed.hardly_turned:
            why = 'hardly turned. Drive curves, and a ramp or a bank'
        elif abs(single @ item.axis) > _NEAR_AXIS:
            why = f'turned about {axis_name(single)} only. Drive a ramp or a bank'
        else:
            why = 'noise too large for the motion. Turn more'
        causes.setdefault((item.status, why), []).append(item)
    found = []
    for (status, why), group in causes.items():
        where = f'{" and ".join(_named(group))} of {frame}'
        values = {'directions': [
            {'kind': item.kind, 'axis': list(item.axis), f'std_{_UNITS[item.kind]}': item.std}
            for item in group]}
        if status == WEAK:
            std = ', '.join(f'{item.std:.2g}' for item in group)
            found.append(Finding('direction-weak', f'{where} weak: standard deviation {std} '
                                 f'{_UNITS[group[0].kind]}. {why}', values))
        else:
            found.append(Finding('direction-unobserved', f'{where} unobservable: {why}, or add '
                                 f'{_priors(group)}, or set allow_unobserved (node)', values))
    return tuple(found)


def _named(items: Sequence[WeakAxis]) -> Iterator[str]:
    """Yield 'translation along x, y' and 'rotation about z'; without axes for all three."""
    kinds = {item.kind for item in items}
    for kind, how in (('translation', 'along'), ('rotation', 'about')):
        axes = [item.axis for item in items if item.kind == kind]
        if len(axes) == 3:
            yield kind
        elif axes and len(kinds) > 1 and any(map(_is_oblique, axes)):
            yield f'part of the {kind}'
        elif axes:
            names = sorted(axis_name(np.array(axis)) for axis in axes)
            yield f'{kind} {how} {", ".join(names)}'


def _priors(items: Sequence[WeakAxis]) -> str:
    """Return the options for a prior of these directions."""
    kinds = {item.kind for item in items}
    if len(kinds) > 1:
        return '--prior-translation, --prior-rotation'
    if kinds == {'rotation'}:
        return '--prior-rotation=ROLL,PITCH,YAW --prior-rotation-std=1'
    axes = [item.axis for item in items]
    # A prior along one axis does not determine an oblique direction.
    meant = range(3) if any(map(_is_oblique, axes)) else np.abs(axes).argmax(axis=1)
    known = ','.join('XYZ'[k] if k in meant else '-' for k in range(3))
    return f'--prior-translation={known} --prior-translation-std=0.01'


def _is_oblique(axis: Iterable[float]) -> bool:
    return max(map(abs, axis)) <= _NEAR_AXIS

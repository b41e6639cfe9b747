# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of two rigs from independent drives: which sensors have moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.errors import ResultError
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import exceedance, FALSE_ALARM
from trajectory_calibration.geometry.observed import misfit, whitener
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.rig.contradictions import describe_size
from trajectory_calibration.rig.result import RigResult, twist_rows
from trajectory_calibration.rig.shared_noise import twist_to_step


@dataclass(frozen=True, eq=False)
class Change:
    """The change of the pose of a sensor.

    Attributes
    ----------
    sensor : its name.
    step, std : (6,), from the old pose in the base to the new one, in covariance order, and its
        standard deviations; for the base about its own axes. NaN for unobservable components.
    chi_squared, degrees, p_value : test of no change along directions that both drives observe.

    """

    sensor: str
    step: FloatArray
    std: FloatArray
    chi_squared: float
    degrees: int
    p_value: float

    def __str__(self) -> str:
        return (f'{self.sensor} moved by {describe_size(self.step)} '
                f'(chi-squared {self.chi_squared:.1f} of {self.degrees}, p = {self.p_value:.1g})')


@dataclass(frozen=True, eq=False)
class RigComparison:
    """The result of a comparison of two rigs.

    Attributes
    ----------
    base : the sensor in whose frame the others are compared.
    sensors : the change of every common sensor in the base; the base itself only if it moved.
    missing : sensors that were not compared.
    changes : sensors that moved, largest change first.
    chi_squared, degrees : test of no change at all.
    same_recording : whether both rigs have a common trajectory; then their errors are correlated,
        and nothing is tested.

    """

    base: str
    sensors: tuple[Change, ...]
    missing: tuple[str, ...]
    changes: tuple[Change, ...]
    chi_squared: float
    degrees: int
    same_recording: bool = False

    @property
    def p_value(self) -> float:
        """Return the p-value of the chi-squared."""
        return exceedance(self.chi_squared, self.degrees)

    @property
    def holds(self) -> bool:
        """Return whether no sensor moved; also True if nothing was compared: see ``whole``."""
        return not self.changes

    @property
    def whole(self) -> bool:
        """Return whether every sensor was compared in one direction at least."""
        return not (self.same_recording or self.missing) and all(
            item.degrees for item in self.sensors)

    def __str__(self) -> str:
        if self.same_recording:
            return ('cannot tell: both rigs are of one recording, and share its errors; compare '
                    'rigs of different drives')
        verdict = '; '.join(map(str, self.changes)) or (
            f'the rig holds (chi-squared {self.chi_squared:.1f} of {self.degrees}, '
            f'p = {self.p_value:.2g})')
        return verdict + (f'; not compared: {", ".join(self.missing)}' if self.missing else '')


def compare_rigs(old: RigResult, new: RigResult) -> RigComparison:
    """Compare two rigs and find the sensors that moved.

    Greedy: the sensor whose change reduces chi-squared most is freed first, until the rest agrees.
    If all sensors seem to move alike, the base has moved. Rigs of one recording are not tested.
    Raises ResultError for fewer than two common sensors.
    """
    base = old.base
    tree = next((names for names in new.trees.values() if base in names), ())
    others = [name for name in old.trees.get(base, ()) if name in tree and name != base]
    if not others:
        raise ResultError(
            f'the rigs have {", ".join(old.sensors)} and {", ".join(new.sensors)}, needed the '
            f'base {base} and one more sensor in both')
    (before, V), (after, V_new) = (_twists(rig, base, others) for rig in (old, new))
    shift = se3.log_se3(np.stack(after) @ se3.inverse(before)).ravel()
    V += V_new
    # Design matrix by sensor: a move of the base moves all others inversely.
    columns = {name: np.kron(np.eye(len(others))[:, [k]], np.eye(6))
               for k, name in enumerate(others)}
    columns[base] = -np.kron(np.ones((len(others), 1)), np.eye(6))
    to_step = {name: twist_to_step(np.eye(4), T) for name, T in zip(others, before, strict=True)}
    to_step[base] = np.eye(6)
    limits = limits_of(new.config.calibration)
    sensors = []
    for k, name in enumerate(others):
        part, L = slice(6 * k, 6 * k + 6), to_step[name]
        step, P = L @ shift[part], L @ V[part, part] @ L.T
        chi_squared, degrees = misfit(step, P, limits)
        std = np.sqrt(np.diagonal(P))
        known = np.where(std < limits, 1.0, np.nan)
        sensors.append(Change(name, known * step, known * std, chi_squared, degrees,
                              exceedance(chi_squared, degrees)))
    K = whitener(V, limits)
    shift = K @ shift
    total, count = float(shift @ shift), len(K)
    remaining, degrees = total, count
    found: list[Change] = []
    free = np.zeros((len(V), 0))
    same_recording = not {*old.recordings}.isdisjoint(new.recordings)
    while not same_recording and degrees > 0 and exceedance(remaining, degrees) < FALSE_ALARM:
        tried = []
        for name, column in columns.items():
            A = np.concatenate([free, limits * column], axis=1)
            # Moves along unobservable directions are not estimated.
            answer, _, rank, _ = np.linalg.lstsq(
                K @ A, shift, rcond=1.0 / max(1.0, float(np.linalg.norm(K @ A, 2))))
            tried.append((float(np.sum((shift - K @ A @ answer)**2)), name,
                          limits * answer[-6:], A, count - int(rank)))
        least, name, twist, free, least_degrees = min(tried, key=lambda item: item[0])
        del columns[name]
        L, gain, gain_degrees = to_step[name], remaining - least, degrees - least_degrees
        # Standard deviations with the limits as a prior, for unobservable directions.
        bound = np.linalg.inv((K @ free[:, -6:]).T @ (K @ free[:, -6:]) + np.eye(6))
        std = np.sqrt(np.diagonal(L @ (np.outer(limits, limits) * bound) @ L.T))
        found.append(Change(name, L @ twist, std, gain, gain_degrees,
                            min(1.0, exceedance(gain, gain_degrees) * len(tried))))
        remaining, degrees = least, least_degrees
    of_base = [item for item in found if item.sensor == base]
    missing = tuple(name for name in old.sensors if name not in (base, *others))
    return RigComparison(base, (*of_base, *sensors), missing, tuple(found), total, count,
                         same_recording)


def _twists(
    rig: RigResult, base: str, others: list[str],
) -> tuple[list[FloatArray], FloatArray]:
    """Return n (4, 4) poses in ``base``, and the (6 n, 6 n) covariance of their twists."""
    Ad = se3.adjoint(se3.inverse(rig.sensors[base].T_base_sensor))
    rows = np.concatenate([
        Ad @ (twist_rows(rig, name) - twist_rows(rig, base)) for name in others])
    return [rig.transform(base, name) for name in others], rows @ rig.covariance @ rows.T

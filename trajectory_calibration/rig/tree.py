# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""A tree of sensors that pairs connect: from their answers to consistent poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.config.prior import Prior
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.observed import drawn_near, unobserved_directions
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.fusion import fuse, fuse_numbers, Fused, spanning_start
from trajectory_calibration.rig.noise import (
    covariances,
    sensor_variances,
    SensorNoise,
    white_and_drift,
)
from trajectory_calibration.rig.pairs import PairAnswer
from trajectory_calibration.rig.shared_noise import (
    half_shared,
    joint_covariance,
    ROUNDING,
    twist_to_step,
    with_stated_blocks,
)
from trajectory_calibration.rig.windows import (
    base_track,
    Clock,
    common_grid,
    Grid,
    window_levels,
    WindowLevel,
)

# Fewest lengths of windows, to estimate the noise.
_FEWEST_LEVELS = 3

# Standard deviation, seconds, of a clock offset if the result has none.
_CLOCK_STD_S = 1e-3

# Log scales below this are rounding of a scale of one.
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Tree:
    """Sensors that pairs connect; the first is the base.

    Attributes
    ----------
    names : (S,).
    ends : (P,), indices of parent and child of each pair.
    clocks : (S,).
    scales, scale_stds : (S,), metres of the base per metre of the sensor.
    answers : (P, 4, 4), in metres of the base.
    C : (P, 6, P, 6), joint covariance of the answers.
    start : (S, 4, 4), approximate poses of the sensors in the base.
    limits : (6,), standard deviations from which a direction is unobserved.
    sensor_noise : (S,), None with too few windows.
    levels, noise, grid : common windows, their (T, S, 6, 6) noise, tracks; without trajectories
        empty or None.

    """

    names: tuple[str, ...]
    ends: tuple[tuple[int, int], ...]
    clocks: tuple[Clock, ...]
    scales: FloatArray
    scale_stds: FloatArray
    answers: FloatArray
    C: FloatArray
    start: FloatArray
    limits: FloatArray
    sensor_noise: tuple[SensorNoise | None, ...]
    levels: tuple[WindowLevel, ...]
    noise: FloatArray | None
    grid: Grid | None

    def unobserved_twists(self) -> list[FloatArray]:
        """Return by sensor the (6, K) twists about the base that its best pair leaves unobserved.

        ``K`` differs between the sensors.
        """
        unobserved = [np.eye(6)] * len(self.names)
        for p, (i, j) in enumerate(self.ends):
            to_base = np.linalg.inv(twist_to_step(self.start[i], self.start[j]))
            of_pair = unobserved_directions(to_base @ self.C[p, :, p] @ to_base.T, self.limits)
            for s in (i, j):
                unobserved[s] = min(unobserved[s], of_pair, key=lambda columns: columns.shape[1])
        return unobserved

    def fuse(
        self, priors: Mapping[int, Prior] | None = None, untrusted: frozenset[int] = frozenset(),
    ) -> Fused:
        """Return consistent poses; pairs of ``untrusted`` sensors do not influence the others."""
        trusted = np.array([not untrusted & {*pair} for pair in self.ends], dtype=np.bool_)
        return fuse(self.start, self.ends, self.answers, self.C, priors=priors, trusted=trusted,
                    limits=self.limits)


def build_tree(
    names: Sequence[str],
    pairs: Sequence[PairAnswer],
    trajectories: Mapping[str, Trajectory],
    settings: CalibrationConfig,
) -> Tree:
    """Return the tree of sensors ``names`` (the base first), which ``pairs`` connect.

    Without ``trajectories`` each sensor is assumed to cause half of the variance of its pairs.
    """
    ends = tuple((names.index(pair.parent), names.index(pair.child)) for pair in pairs)
    results = [pair.result for pair in pairs]
    sensors = len(names)
    stated = np.stack([pair.covariance + np.diag(ROUNDING**2) for pair in pairs])
    answers = np.stack([result.T_a_b for result in results])
    clocks = _clocks(sensors, ends, results)
    logs, stds = fuse_numbers(
        sensors, ends, np.log([result.scale for result in results]),
        np.maximum([log_scale_std_of(result) for result in results], 0.1 * _ROUNDING))
    unit = (np.abs(logs) < _ROUNDING) & (stds < _ROUNDING)
    scales, stds = np.where(unit, 1.0, np.exp(logs)), np.where(unit, 0.0, np.exp(logs) * stds)
    # Answers of pairs are in metres of their parents.
    of_parents = scales[[i for i, _ in ends]]
    answers[:, :3, 3] *= of_parents[:, None]
    stated[:, :3] *= of_parents[:, None, None]
    stated[:, :, :3] *= of_parents[:, None, None]
    limits = limits_of(settings)
    start = _align_unobserved(answers, stated, ends, sensors, limits)
    levels: list[WindowLevel] = []
    grid = None
    if trajectories:
        grid = common_grid([
            base_track(trajectories[name], clock, float(scale), X)
            for name, clock, scale, X in zip(names, clocks, scales, start, strict=True)],
            round(settings.max_gap * 1e9))
        levels = window_levels(grid)
    noise: FloatArray | None = None
    sensor_noise: Sequence[SensorNoise | None] = [None] * sensors
    M = np.einsum('pq,ab->paqb', half_shared(sensors, ends), np.eye(6))
    if len(levels) >= _FEWEST_LEVELS:
        variances = sensor_variances(levels, start)
        noise, sensor_noise = covariances(variances, start), white_and_drift(levels, variances)
        M = joint_covariance(levels, noise, ends)
    return Tree(
        tuple(names), ends, clocks, scales, stds, answers,
        with_stated_blocks(M, stated, start, ends), start, limits, tuple(sensor_noise),
        tuple(levels), noise, grid)


def clock_of(result: CalibrationResult) -> Clock:
    """Return the clock of b against a; its standard deviation is 0 if the result has none."""
    std = (result.diagnosis or {}).get('time_offset_deviation_s')
    return Clock(result.time_offset_s, result.clock_drift, result.clock_drift_from_ns,
                 float(std or 0.0))


def log_scale_std_of(result: CalibrationResult) -> float:
    """Return the standard deviation of the log scale of a result; 0 if it has none."""
    diagnosis = result.diagnosis or {}
    return float(diagnosis.get('scale_deviation') or 0.0) / float(diagnosis.get('scale') or 1.0)


def _align_unobserved(
    answers: FloatArray, stated: FloatArray, ends: Sequence[tuple[int, int]], sensors: int,
    limits: FloatArray,
) -> FloatArray:
    """Move answers along unobservable directions, in place, so that they agree.

    Returns the (S, 4, 4) poses of the sensors in the base.
    """
    for p, T in enumerate(answers):
        rotation = se3.from_rotation_translation(T[:3, :3], np.zeros(3))
        answers[p], stated[p] = drawn_near(T, stated[p], rotation, limits)
    start = spanning_start(sensors, ends, answers, stated)
    for p, (i, j) in enumerate(ends):
        T_i_j = se3.inverse(start[i]) @ start[j]
        answers[p], stated[p] = drawn_near(answers[p], stated[p], T_i_j, limits)
    return start


def _clocks(
    sensors: int, ends: Sequence[tuple[int, int]], results: Sequence[CalibrationResult],
) -> tuple[Clock, ...]:
    """Return the clock of each sensor against the base, consistent over all loops."""
    epoch_ns = next((result.clock_drift_from_ns for result in results if result.clock_drift), 0)
    of_pairs = [clock_of(result) for result in results]
    stds = np.array([clock.offset_std_s or _CLOCK_STD_S for clock in of_pairs])
    offsets, offset_stds = fuse_numbers(
        sensors, ends, np.array([clock.at(epoch_ns) for clock in of_pairs]), stds)
    drifts, _ = fuse_numbers(sensors, ends, np.array([clock.drift for clock in of_pairs]), stds)
    return tuple(
        Clock(float(offset), float(drift), epoch_ns, float(std))
        for offset, drift, std in zip(offsets, drifts, offset_stds, strict=True))

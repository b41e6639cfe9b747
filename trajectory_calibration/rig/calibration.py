# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``calibrate_rig``: one consistent rig from the trajectories of several sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import DEGREES_OF_FREEDOM
from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.data.trajectory import recording_of, recordings_in, Trajectory
from trajectory_calibration.errors import (
    CalibrationError,
    ConfigError,
    TrajectoryError,
    unknown_name,
)
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.advice import with_rig_keys
from trajectory_calibration.rig.contradictions import (
    clock_contradictions,
    contradicting_sensors,
    prior_contradictions,
    unconnected_sensors,
)
from trajectory_calibration.rig.pairs import (
    calibrate_pairs,
    connected,
    PairAnswer,
    PairFailure,
    split_failures,
)
from trajectory_calibration.rig.result import (
    PairReport,
    RigResult,
    SensorAnswer,
    statuses,
)
from trajectory_calibration.rig.settings import RigConfig
from trajectory_calibration.rig.tree import build_tree, clock_of, log_scale_std_of

# Code of the finding by kind of contradiction.
_CODES = {
    'moved': 'rig-mount-moved', 'clock': 'rig-clock', 'loops': 'rig-contradiction',
    'vehicle': 'rig-other-motion', 'time': 'rig-no-common-time', 'prior': 'prior-contradicts'}

_ASSUMED = Finding('rig-shared-noise', (
    'assumed: each sensor causes half of the error of its pairs. Saved results hold no '
    'trajectories, or these are too short. To measure it, run rig RIG.yaml on a longer drive'
))

# Components that curves determine; ramps and banks determine the others.
_SHOWN_BY_CURVES = ('x', 'y', 'rotation z')


def calibrate_rig(
    trajectories: Mapping[str, Trajectory], config: RigConfig | None = None,
) -> RigResult:
    """Estimate the poses of several sensors in the base from their trajectories.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By sensor name; two or more.
    config : RigConfig, optional
        Settings, by default those of RigConfig().

    Returns
    -------
    RigResult
        Of every sensor with a calibrated pair; several trees if not all sensors are connected. For
        two sensors the answer is that of ``calibrate``.

    Raises
    ------
    CalibrationError
        ConfigError for names that do not match, TrajectoryError, or the error of a pair if no pair
        has an answer.

    """
    config = config or RigConfig()
    if len(trajectories) < 2:
        raise ConfigError(f'{len(trajectories)} sensors were given, needed two or more')
    for name, trajectory in trajectories.items():
        if not isinstance(trajectory, Trajectory):
            raise TrajectoryError(
                f'sensor {name} is of type {type(trajectory).__name__}, needed a Trajectory')
    names = _base_first(trajectories, config)
    metric = [name for name in trajectories if config.of(name).scale != 'free']
    if metric and names[0] not in metric:
        raise ConfigError(
            f'the base {names[0]} has scale free, so the rig would have no metric scale; choose '
            f'another base, such as {metric[0]}')
    if len(names) == 2:
        rig = _of_two(names[0], names[1], trajectories, config)
    else:
        answers, failures = calibrate_pairs(trajectories, names[0], config)
        rig = _of_answers(answers, failures, names, trajectories, config)
    return replace(rig, recordings=tuple(map(recording_of, trajectories.values())))


def fuse_results(
    results: Sequence[CalibrationResult], config: RigConfig | None = None,
) -> RigResult:
    """Fuse results of pairs to one rig; the names of the sensors are their frames.

    Without trajectories the correlation of the pairs is unknown: each sensor is assumed to cause
    half of the variance of its pairs, and there is a finding. Raises ConfigError for no results, a
    pair with two results, or a base that is in no result.
    """
    config = config or RigConfig()
    if not results:
        raise ConfigError('no results were given, needed one of each pair')
    ends = [(result.frame_a, result.frame_b) for result in results]
    pairs = list(map(frozenset, ends))
    for (a, b), pair in zip(ends, pairs, strict=True):
        if a == b:
            raise ConfigError(f'a result has the frame {a} twice; name the frames of both sensors')
        if pairs.count(pair) > 1:
            raise ConfigError(f'two results hold {a} and {b}; needed one of each pair')
    names = _base_first(dict.fromkeys(name for pair in ends for name in pair), config)
    answers, failures = split_failures(
        PairAnswer(result.frame_a, result.frame_b, result) for result in results)
    return replace(
        _of_answers(answers, failures, names, {}, config),
        recordings=tuple(dict.fromkeys(
            one for result in results if result.recording is not None
            for one in recordings_in(result.recording))))


def _base_first(given: Iterable[str], config: RigConfig) -> list[str]:
    """Return the names of the sensors; raises ConfigError if the settings have others."""
    names = list(given)
    for name in (*config.sensors, config.base or names[0]):
        if name not in names:
            raise ConfigError(unknown_name('sensor', name, list(names)))
    return sorted(names, key=lambda name: name != (config.base or names[0]))


def _of_two(
    base: str, other: str, trajectories: Mapping[str, Trajectory], config: RigConfig,
) -> RigResult:
    """Return the rig of two sensors from ``calibrate``."""
    calibration = replace(
        config.calibration, **config.of(other).given, **config.scale_of(other))
    try:
        result = calibrate(trajectories[base], trajectories[other], calibration)
    except CalibrationError as error:
        raise type(error)(with_rig_keys(str(error), base, other)) from error
    solved, failures = split_failures([PairAnswer(base, other, result)])
    if not solved:
        raise _no_answer(failures, 2)
    covariance = solved[0].covariance
    sensors = {
        base: _answer(base, base, np.eye(4), np.zeros((6, 6)), config, trajectories),
        other: _answer(
            other, base, result.T_a_b, covariance, config, trajectories,
            status=dict(result.observability.status), scale=result.scale,
            scale_std=result.scale * log_scale_std_of(result),
            clock=clock_of(result))}
    pair = PairReport(base, other, residual=np.zeros(6), std=np.sqrt(np.diagonal(covariance)),
                      poses=result.poses)
    return RigResult(
        base=base, sensors=sensors, covariance=covariance, free=(other,), pairs=(pair,),
        contradictions=(), chi_squared=0.0, degrees=0, findings=tuple(
            replace(found, text=with_rig_keys(found.text, base, other))
            for found in result.findings), config=config)


def _no_answer(failures: Sequence[PairFailure], sensors: int) -> CalibrationError:
    reasons = '; '.join(f'{pair.parent} - {pair.child}: {pair.reason}' for pair in failures[:3])
    return CalibrationError(f'no two of {sensors} sensors gave an answer: {reasons}')


def _of_answers(
    solved: Sequence[PairAnswer], failures: Sequence[PairFailure], names: Sequence[str],
    trajectories: Mapping[str, Trajectory], config: RigConfig,
) -> RigResult:
    """Return the rig from the answers of pairs, tree by tree."""
    if not solved:
        raise _no_answer(failures, len(names))
    groups = connected(names, solved)
    parts = [
        _solve_group(group, [pair for pair in solved if pair.parent in group], trajectories,
                     config)
        for group in groups if len(group) > 1]
    sensors = {name: part.sensors[name]
               for name in names for part in parts if name in part.sensors}
    contradictions = [*unconnected_sensors(groups, failures),
                      *(item for part in parts for item in part.contradictions)]
    of_part = np.repeat(np.arange(len(parts)), [len(part.covariance) for part in parts])
    covariance = np.zeros((len(of_part), len(of_part)))
    covariance[of_part[:, None] == of_part] = np.concatenate(
        [part.covariance.ravel() for part in parts])
    rig = RigResult(
        base=next(iter(sensors.values())).base, sensors=sensors, covariance=covariance,
        free=tuple(name for part in parts for name in part.free),
        pairs=(*(PairReport(pair.parent, pair.child, pair.reason, used=False)
                 for pair in failures), *(pair for part in parts for pair in part.pairs)),
        contradictions=tuple(contradictions),
        chi_squared=sum(part.chi_squared for part in parts),
        degrees=sum(part.degrees for part in parts),
        findings=tuple(found for part in parts for found in part.findings)[:1],
        config=config)
    return replace(rig, findings=worst_first((*_findings(rig), *rig.findings, *_of_pairs(solved))))


def _solve_group(
    group: Sequence[str], answers: Sequence[PairAnswer],
    trajectories: Mapping[str, Trajectory], config: RigConfig,
) -> RigResult:
    """Return the rig of one tree of sensors."""
    tree = build_tree(group, answers, trajectories, config.calibration)
    priors = {k: prior for k, name in enumerate(group)
              if k and (prior := config.of(name).prior).given}
    untrusted, contradictions = contradicting_sensors(tree)
    from_motion = tree.fuse(untrusted=untrusted)
    contradictions += prior_contradictions(tree, from_motion, priors)
    fused = tree.fuse(priors, untrusted) if priors else from_motion
    contradictions += clock_contradictions(group, tree.clocks)
    left_out = {group[k] for k in untrusted if k} if config.leave_out_contradicting else set()
    kept = [k for k, name in enumerate(group) if k and name not in left_out]
    rows = [row for k in kept for row in range(6 * k - 6, 6 * k)]
    sensors = {}
    for k in (0, *kept):
        status, by_motion = (
            statuses(each.of(k), config.calibration) for each in (fused, from_motion))
        sensors[group[k]] = _answer(
            group[k], group[0], fused.X[k], fused.of(k), config, trajectories,
            status={name: 'prior' if by_motion[name] == 'unobserved' != value else value
                    for name, value in status.items()},
            scale=float(tree.scales[k]), scale_std=float(tree.scale_stds[k]),
            clock=tree.clocks[k], noise=tree.sensor_noise[k])
    reports = tuple(
        PairReport(
            pair.parent, pair.child, residual=fused.residuals[p],
            std=np.sqrt(np.diagonal(tree.C[p, :, p])),
            chi_squared=float(fused.pair_chi_squared[p]), degrees=int(fused.pair_degrees[p]),
            poses=pair.result.poses, used=not untrusted & {*tree.ends[p]})
        for p, pair in enumerate(answers))
    return RigResult(
        base=group[0], sensors=sensors, covariance=fused.covariance[np.ix_(rows, rows)],
        free=tuple(group[k] for k in kept), pairs=reports,
        contradictions=tuple(
            replace(item, left_out=item.sensor in left_out) for item in contradictions),
        chi_squared=from_motion.chi_squared, degrees=from_motion.degrees,
        findings=(_ASSUMED,) if tree.noise is None and len(answers) > 1 else (), config=config)


def _answer(
    name: str, base: str, X: FloatArray, covariance: FloatArray, config: RigConfig,
    trajectories: Mapping[str, Trajectory], **known: Any,
) -> SensorAnswer:
    trajectory = trajectories.get(name)
    return SensorAnswer(name=name, base=base, T_base_sensor=X, covariance=covariance, **{
        'frame': config.of(name).frame or (name if trajectory is None else
                                           trajectory.sensor_frame),
        'status': statuses(covariance, config.calibration),
        'poses': 0 if trajectory is None else len(trajectory), **known})


def _findings(rig: RigResult) -> tuple[Finding, ...]:
    """Return the findings about a rig, without those of single pairs."""
    found = [
        Finding(_CODES[item.kind], item.text, {'sensor': item.sensor, 'p_value': item.p_value})
        for item in rig.contradictions]
    if len(rig.trees) > 1:
        found.append(Finding('rig-groups', (
            f'{len(rig.trees)} groups of sensors share no motion with each other: '
            f'{"; ".join(map(", ".join, rig.trees.values()))}. Each is calibrated separately')))
    unobserved = {
        component: [name for name, sensor in rig.sensors.items() if component in sensor.unobserved]
        for component in DEGREES_OF_FREEDOM}
    found += [
        Finding('direction-unobserved', (
            f'{component} of {", ".join(names)} unobservable. Drive '
            f'{"curves" if component in _SHOWN_BY_CURVES else "ramps and banks"}, or '
            'measure it and write prior_translation or prior_rotation (and its _std) below the '
            'sensor in RIG.yaml'), {'component': component, 'sensors': names})
        for component, names in unobserved.items() if names]
    if rig.p_value < FALSE_ALARM:
        found.append(Finding('rig-loops', (
            f'the loops do not close within the standard deviations (p = {rig.p_value:.1g}): the '
            'standard deviations are too small'), {'p_value': rig.p_value}))
    return tuple(found)


def _of_pairs(answers: Sequence[PairAnswer]) -> tuple[Finding, ...]:
    """Return the serious findings of single pairs, except unobservable directions."""
    return tuple(
        replace(found, text=f'{answer.parent} - {answer.child}: '
                + with_rig_keys(found.text, answer.parent, answer.child))
        for answer in answers
        for found in answer.result.findings
        if found.level == 'serious' and found.code != 'direction-unobserved')

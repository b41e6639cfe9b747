# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""``calibrate_rig``: trajectories of several sensors in, one consistent rig out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import CalibrationError, ConfigError, TrajectoryError
from trajectory_calibration.geometry.chi_squared import FALSE_ALARM
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.advice import in_rig_words
from trajectory_calibration.rig.clocks import Clock
from trajectory_calibration.rig.doubts import (
    against_priors,
    block_of,
    doubt,
    other_clocks,
    unconnected,
)
from trajectory_calibration.rig.observed import probability
from trajectory_calibration.rig.pairs import (
    answer_of,
    calibrate_pairs,
    connected,
    PairAnswer,
    PairFailure,
)
from trajectory_calibration.rig.result import (
    Contradiction,
    judged,
    PairReport,
    RigResult,
    SensorAnswer,
)
from trajectory_calibration.rig.settings import RigConfig
from trajectory_calibration.rig.tree import build_tree, log_scale_std_of, offset_std_of, Pair

# The finding of each kind of contradiction.
_CODES = {
    'moved': 'rig-mount-moved', 'clock': 'rig-clock', 'loops': 'rig-contradiction',
    'vehicle': 'rig-other-motion', 'time': 'rig-no-common-time', 'prior': 'prior-contradicts'}

_ASSUMED = Finding('rig-shared-noise', (
    'assumed: each sensor causes half of the error of its pairs. Saved results hold no '
    'trajectories, or these are too short. To measure it, run rig RIG.yaml on a longer drive'
))

# What a driver does about a component that is open.
_SHOWN_BY = {
    'x': 'curves', 'y': 'curves', 'z': 'ramps and banks', 'rotation x': 'ramps and banks',
    'rotation y': 'ramps and banks', 'rotation z': 'curves'}


def calibrate_rig(
    trajectories: Mapping[str, Trajectory], config: RigConfig | None = None,
) -> RigResult:
    """Find the poses of several sensors in the base from their trajectories.

    Parameters
    ----------
    trajectories : mapping of str to Trajectory
        By the name of the sensor; two or more.
    config : RigConfig, optional
        Settings; the defaults where omitted.

    Returns
    -------
    RigResult
        With the pose of every sensor that shares motion with others, by trees where not all do.
        The answer of two sensors is that of ``calibrate``.

    Raises
    ------
    CalibrationError
        One of its subclasses: ConfigError (names that do not fit), TrajectoryError, or the error
        of a pair where no two sensors give an answer.

    """
    config = config or RigConfig()
    base = _validated(trajectories, config)
    if len(trajectories) == 2:
        return _of_two(trajectories, base, config)
    answers, failures = calibrate_pairs(trajectories, base, config)
    return _of_answers(answers, failures, [base, *(name for name in trajectories if name != base)],
                       trajectories, config)


def fuse_results(
    results: Sequence[CalibrationResult], config: RigConfig | None = None,
) -> RigResult:
    """Make one rig of saved answers of pairs; sensors are named by their frames.

    Without trajectories nobody knows what the pairs share: each sensor is taken to have half of
    what its pairs err, and a finding says so.

    Raises
    ------
    ConfigError
        No results, a pair that is there twice, or a base that none of them has.

    """
    config = config or RigConfig()
    if not results:
        raise ConfigError('no results were given, needed one of each pair')
    names: list[str] = []
    seen: set[frozenset[str]] = set()
    for result in results:
        ends = frozenset((result.frame_a, result.frame_b))
        if len(ends) < 2:
            raise ConfigError(f'a result has the frame {result.frame_a} twice; name the frames '
                              'of both sensors')
        if ends in seen:
            raise ConfigError(f'two results hold {result.frame_a} and {result.frame_b}; needed '
                              'one of each pair')
        seen.add(ends)
        names += [name for name in (result.frame_a, result.frame_b) if name not in names]
    base = config.base or names[0]
    _require_names(config, names)
    found = [answer_of(result.frame_a, result.frame_b, result) for result in results]
    answers = [pair for pair in found if isinstance(pair, PairAnswer)]
    failures = [pair for pair in found if isinstance(pair, PairFailure)]
    ordered = [base, *(name for name in names if name != base)]
    return _of_answers(answers, failures, ordered, {}, config)


def _validated(trajectories: Mapping[str, Trajectory], config: RigConfig) -> str:
    """Return the name of the base."""
    if len(trajectories) < 2:
        raise ConfigError(f'{len(trajectories)} sensors were given, needed two or more')
    for name, trajectory in trajectories.items():
        if not isinstance(trajectory, Trajectory):
            raise TrajectoryError(
                f'sensor {name} is of type {type(trajectory).__name__}, needed a Trajectory')
    _require_names(config, list(trajectories))
    base = config.base or next(iter(trajectories))
    metric = [name for name in trajectories if config.of(name).scale != 'free']
    if metric and base not in metric:
        raise ConfigError(
            f'the base {base} has scale free, so that the rig would have no metres; choose '
            f'another base, such as {metric[0]}')
    return base


def _require_names(config: RigConfig, names: Sequence[str]) -> None:
    for name in (*config.sensors, *([config.base] if config.base else [])):
        if name not in names:
            raise ConfigError(f'sensor {name!r} is unknown; known are {", ".join(names)}')


def _of_two(
    trajectories: Mapping[str, Trajectory], base: str, config: RigConfig,
) -> RigResult:
    """Return the answer of ``calibrate`` as a rig."""
    other = next(name for name in trajectories if name != base)
    settings = config.of(other)
    calibration = replace(
        config.calibration, prior_translation=settings.prior_translation,
        prior_translation_std=settings.prior_translation_std,
        prior_rotation=settings.prior_rotation, prior_rotation_std=settings.prior_rotation_std)
    if settings.scale == 'free':
        calibration = replace(calibration, scale_mode='estimate', scale=1.0)
    try:
        result = calibrate(trajectories[base], trajectories[other], calibration)
    except CalibrationError as error:
        raise type(error)(in_rig_words(str(error), base, other)) from error
    covariance = np.eye(6) if result.covariance is None else np.asarray(result.covariance)
    sensors = {
        base: _answer(base, base, np.eye(4), np.zeros((6, 6)), config, trajectories),
        other: replace(
            _answer(other, base, result.T_a_b, covariance, config, trajectories),
            status=_status_of(result, covariance, config), scale=result.scale,
            scale_std=result.scale * log_scale_std_of(result),
            clock=Clock(result.time_offset_s, result.clock_drift, result.clock_drift_from_ns,
                        offset_std_of(result)))}
    pair = PairReport(base, other, residual=np.zeros(6), std=np.sqrt(np.diagonal(covariance)),
                      poses=result.poses)
    return RigResult(
        base=base, sensors=sensors, covariance=covariance, free=(other,), pairs=(pair,),
        contradictions=(), chi_squared=0.0, degrees=0, p_value=1.0,
        findings=tuple(
            replace(found, text=in_rig_words(found.text, base, other))
            for found in result.findings), config=config)


def _of_answers(
    solved: Sequence[PairAnswer], failures: Sequence[PairFailure], names: Sequence[str],
    trajectories: Mapping[str, Trajectory], config: RigConfig,
) -> RigResult:
    """Return the rig of the answers of pairs, tree by tree."""
    if not solved:
        reasons = '; '.join(f'{pair.parent} - {pair.child}: {pair.reason}'
                            for pair in failures[:3])
        raise CalibrationError(f'no two of {len(names)} sensors gave an answer: {reasons}')
    groups = connected(names, solved)
    sensors: dict[str, SensorAnswer] = {}
    blocks: list[FloatArray] = []
    free: list[str] = []
    reports: dict[tuple[str, str], PairReport] = {
        (pair.parent, pair.child): PairReport(pair.parent, pair.child, pair.reason, used=False)
        for pair in failures}
    contradictions = unconnected(groups, failures)
    of_groups: list[Finding] = []
    chi_squared, degrees = 0.0, 0
    for group in groups:
        if len(group) == 1:
            continue
        of_group = [answer for answer in solved if answer.parent in group]
        part = _solve_group(group, of_group, trajectories, config)
        sensors.update(part.sensors)
        blocks.append(part.covariance)
        free += part.free
        contradictions += part.contradictions
        of_groups += part.findings
        reports.update({(pair.parent, pair.child): pair for pair in part.pairs})
        chi_squared += part.chi_squared
        degrees += part.degrees
    ordered = {name: sensors[name] for name in names if name in sensors}
    p_value = probability(chi_squared, degrees)
    return RigResult(
        base=names[0] if names[0] in sensors else next(iter(ordered.values())).base,
        sensors=ordered, covariance=_block_diagonal(blocks), free=tuple(free),
        pairs=tuple(reports.values()), contradictions=tuple(contradictions),
        chi_squared=chi_squared, degrees=degrees, p_value=p_value,
        findings=worst_first((
            *_findings(ordered, groups, contradictions, p_value), *of_groups[:1],
            *_of_pairs(solved))),
        config=config)


def _solve_group(
    group: Sequence[str], answers: Sequence[PairAnswer],
    trajectories: Mapping[str, Trajectory], config: RigConfig,
) -> RigResult:
    """Return the rig of sensors that are connected."""
    number = {name: k for k, name in enumerate(group)}
    pairs = [Pair(number[answer.parent], number[answer.child], answer.result, answer.covariance)
             for answer in answers]
    tree = build_tree(
        group, pairs, trajectories, [config.of(name).scale == 'free' for name in group],
        config.calibration)
    priors = {number[name]: config.of(name).prior for name in group[1:]
              if config.of(name).prior.given}
    doubted, contradictions = doubt(tree)
    without = tree.fuse(doubted=doubted)
    contradictions += against_priors(tree, without, priors)
    fused = tree.fuse(priors, doubted) if priors else without
    contradictions += other_clocks(tree)
    left_out = {k for k in doubted if k} if config.leave_out_contradicting else set()
    contradictions = [
        replace(item, left_out=number[item.sensor] in left_out) for item in contradictions]
    kept = [k for k in range(1, len(group)) if k not in left_out]
    rows = np.concatenate([np.arange(6 * k - 6, 6 * k) for k in kept] or [np.zeros(0, int)])
    sensors = {}
    for k in (0, *kept):
        answer = _answer(
            group[k], group[0], fused.X[k], block_of(fused, k), config, trajectories)
        by_motion = judged(block_of(without, k), config.calibration)
        sensors[group[k]] = replace(
            answer,
            status={name: 'prior' if by_motion[name] == 'unobserved' != status else status
                    for name, status in answer.status.items()},
            scale=float(tree.scales[k]), scale_std=float(tree.scale_stds[k]),
            clock=tree.clocks[k],
            noise=tree.sensor_noise[k] if tree.sensor_noise else None)
    reports = tuple(
        PairReport(
            group[pair.parent], group[pair.child], residual=fused.residuals[p],
            std=np.sqrt(np.diagonal(tree.C[p, :, p])),
            chi_squared=float(fused.pair_chi_squared[p]), degrees=int(fused.pair_degrees[p]),
            poses=pair.result.poses,
            used=not doubted & {pair.parent, pair.child})
        for p, pair in enumerate(pairs))
    return RigResult(
        base=group[0], sensors=sensors, covariance=fused.covariance[np.ix_(rows, rows)],
        free=tuple(group[k] for k in kept), pairs=reports, contradictions=tuple(contradictions),
        chi_squared=without.chi_squared, degrees=without.degrees,
        p_value=probability(without.chi_squared, without.degrees),
        findings=(_ASSUMED,) if tree.noise is None and len(pairs) > 1 else (), config=config)


def _answer(
    name: str, base: str, X: FloatArray, covariance: FloatArray, config: RigConfig,
    trajectories: Mapping[str, Trajectory],
) -> SensorAnswer:
    trajectory = trajectories.get(name)
    frame = config.of(name).frame or (name if trajectory is None else trajectory.sensor_frame)
    return SensorAnswer(
        name=name, frame=frame, base=base, T_base_sensor=X, covariance=covariance,
        status=judged(covariance, config.calibration),
        poses=0 if trajectory is None else len(trajectory))


def _status_of(
    result: CalibrationResult, covariance: FloatArray, config: RigConfig,
) -> dict[str, str]:
    """Return the status that ``calibrate`` gave, with the words of a rig."""
    return {**judged(covariance, config.calibration), **dict(result.observability.status)}


def _findings(
    sensors: Mapping[str, SensorAnswer], groups: Sequence[Sequence[str]],
    contradictions: Sequence[Contradiction], p_value: float,
) -> tuple[Finding, ...]:
    found = [
        Finding(_CODES[item.kind], item.text, {'sensor': item.sensor, 'p_value': item.p_value})
        for item in contradictions]
    trees = [group for group in groups if len(group) > 1]
    if len(trees) > 1:
        found.append(Finding('rig-groups', (
            f'{len(trees)} groups of sensors share no motion with each other: '
            f'{"; ".join(", ".join(tree) for tree in trees)}. Each is answered by itself')))
    open_: dict[str, list[str]] = {}
    for sensor in sensors.values():
        for component in sensor.unobserved:
            open_.setdefault(component, []).append(sensor.name)
    found += [
        Finding('direction-unobserved', (
            f'{component} of {", ".join(names)} unobservable. Drive {_SHOWN_BY[component]}, or '
            'measure it and write prior_translation or prior_rotation (and its _std) below the '
            'sensor in RIG.yaml'), {'component': component, 'sensors': names})
        for component, names in open_.items()]
    if p_value < FALSE_ALARM:
        found.append(Finding('rig-loops', (
            f'the loops do not close within the standard deviations (p = {p_value:.1g}): the '
            'standard deviations are too small'), {'p_value': p_value}))
    return tuple(found)


def _of_pairs(answers: Sequence[PairAnswer]) -> tuple[Finding, ...]:
    """Return what is serious about single pairs and said nowhere else."""
    return tuple(
        replace(found, text=f'{answer.parent} - {answer.child}: '
                + in_rig_words(found.text, answer.parent, answer.child))
        for answer in answers
        for found in answer.result.findings
        if found.level == 'serious' and found.code != 'direction-unobserved')


def _block_diagonal(blocks: Sequence[FloatArray]) -> FloatArray:
    size = sum(len(block) for block in blocks)
    result, start = np.zeros((size, size)), 0
    for block in blocks:
        end = start + len(block)
        result[start:end, start:end] = block
        start = end
    return result

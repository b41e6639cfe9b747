# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Selection and calibration of pairs of sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from operator import itemgetter

import numpy as np

from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.errors import AssociationError, CalibrationError
from trajectory_calibration.executor import Executor
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.rig.advice import with_rig_keys
from trajectory_calibration.rig.settings import RigConfig

# Most sensors for which every pair is calibrated.
_EVERY_PAIR = 4

# With more sensors, all are paired with the base and with this many others.
_HUBS = 2

# Most poses of a pair with a hub: it only checks the others, and its covariance is larger.
_CHECKED_POSES = 2000

# Fewest poses of all sensors for which processes, which take 0.7 s to start, save time.
_WORTH_PROCESSES = 20_000

# Parent, child, their trajectories, and the settings.
_Task = tuple[str, str, Trajectory, Trajectory, RigConfig]


@dataclass(frozen=True, eq=False)
class PairAnswer:
    """The result of a pair, which has a covariance, and the names of its sensors."""

    parent: str
    child: str
    result: CalibrationResult

    @property
    def covariance(self) -> FloatArray:
        """Return the (6, 6) covariance of the result."""
        return np.asarray(self.result.covariance)


@dataclass(frozen=True)
class PairFailure:
    """Why a pair has no answer, and whether the reason is that it has no common time."""

    parent: str
    child: str
    reason: str
    no_common_time: bool = False


def split_failures(
    pairs: Iterable[PairAnswer | PairFailure],
) -> tuple[list[PairAnswer], list[PairFailure]]:
    """Return the answers and the failures; an answer without a covariance is a failure."""
    answers: list[PairAnswer] = []
    failures: list[PairFailure] = []
    for pair in pairs:
        if isinstance(pair, PairFailure):
            failures.append(pair)
        elif pair.result.covariance is None:
            failures.append(PairFailure(pair.parent, pair.child, (
                'the solver states no covariance; use another one')))
        else:
            answers.append(pair)
    return answers, failures


def _calibrated(task: _Task) -> PairAnswer | PairFailure:
    parent, child, a, b, config = task
    settings = replace(
        config.calibration, allow_unobserved=True, **config.scale_of(child))
    try:
        return PairAnswer(parent, child, calibrate(a, b, settings))
    except CalibrationError as error:
        return PairFailure(parent, child, with_rig_keys(str(error), parent, child),
                           no_common_time=isinstance(error, AssociationError))


def calibrate_pairs(
    trajectories: Mapping[str, Trajectory], base: str, config: RigConfig,
) -> tuple[list[PairAnswer], list[PairFailure]]:
    """Calibrate the pairs of the settings.

    The child of a pair is the sensor with free scale, otherwise the later one; the base is first.
    """
    names = [base, *(name for name in trajectories if name != base)]
    order = sorted(names, key=lambda name: config.of(name).scale == 'free').index
    found: dict[frozenset[str], PairAnswer | PairFailure] = {}
    worth = sum(map(len, trajectories.values())) >= _WORTH_PROCESSES
    executor = Executor(processes=config.processes or (0 if worth else 1))

    def extend(wanted: Iterable[tuple[str, str]], most: int = 0) -> list[PairAnswer]:
        """Calibrate new pairs, with ``most`` poses at most (0: all); return all answers."""
        new = dict.fromkeys((min(pair, key=order), max(pair, key=order)) for pair in wanted
                            if frozenset(pair) not in found)
        tasks = [(parent, child, _thinned(trajectories[parent], most),
                  _thinned(trajectories[child], most), config) for parent, child in new]
        found.update(zip(map(frozenset, new), _run(tasks, executor), strict=True))
        return split_failures(found.values())[0]

    if config.pairs == 'all' or (config.pairs == 'auto' and len(names) <= _EVERY_PAIR):
        extend(combinations(names, 2))
        return split_failures(found.values())
    answers = extend((base, name) for name in names[1:])
    if config.pairs == 'auto':
        hubs = _hubs(answers, base, config)
        answers = extend(((hub, name) for hub in hubs for name in names if name != hub),
                         _CHECKED_POSES)
    # Sensors without an answer to the base may have one to each other.
    extend((one, other) for group, others in combinations(connected(names, answers), 2)
           for one in group for other in others)
    return split_failures(found.values())


def _hubs(answers: Sequence[PairAnswer], base: str, config: RigConfig) -> list[str]:
    """Return the sensors with the smallest covariance to the base; metric ones come first."""
    badness = {}
    for answer in answers:
        name, = {answer.parent, answer.child} - {base}
        # Geometric mean, so that a height that is unobservable by all has no influence.
        values = np.maximum(np.linalg.eigvalsh(answer.covariance), 1e-30)
        badness[name] = config.of(name).scale == 'free', float(np.mean(np.log(values)))
    return sorted(badness, key=badness.__getitem__)[:_HUBS]


def connected(names: Sequence[str], answers: Sequence[PairAnswer]) -> list[list[str]]:
    """Return the groups of sensors that answers connect, in the order of the names."""
    group = {name: {name} for name in names}
    for answer in answers:
        both = group[answer.parent] | group[answer.child]
        group.update(dict.fromkeys(both, both))
    found = {id(group[name]): group[name] for name in names}
    return [[name for name in names if name in members] for members in found.values()]


def _thinned(trajectory: Trajectory, most: int) -> Trajectory:
    stride = -(-len(trajectory) // most) if most else 1
    return trajectory if stride == 1 else replace(
        trajectory, stamps_ns=trajectory.stamps_ns[::stride],
        poses=trajectory.poses[::stride], findings=())


def _run(tasks: Sequence[_Task], executor: Executor) -> list[PairAnswer | PairFailure]:
    """Calibrate pairs, in this process if there is one only."""
    count = min(executor.count, len(tasks))
    if count < 2:
        return list(map(_calibrated, tasks))
    # Not forked: the caller may have threads, of ROS or a notebook, whose locks a copy of the
    # process would never release.
    found = replace(executor, processes=count).unordered(_calibrated, tasks)
    return [answer for _, answer in sorted(found, key=itemgetter(0))]

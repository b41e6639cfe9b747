# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Change detection over many calibrations of one pair of sensors.

The answers, in the order of their dates, are split into stretches within which they agree. The
split minimises the sum of chi-squared about the mean of each stretch plus a penalty per change.
It is found by dynamic programming (B. Jackson et al., "An algorithm for optimal partitioning of
data on an interval", IEEE Signal Processing Letters 12(2), 2005, doi:10.1109/LSP.2001.838216).
The penalty is a quantile of chi-squared: it bounds the probability of a false change at any of
the possible places. A mean is formed within a stretch only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.assessment.observability import limits_of
from trajectory_calibration.errors import counted, in_sigmas, ResultError
from trajectory_calibration.exit_status import CHANGED, DONE
from trajectory_calibration.fleet.differences import (
    aligned_step,
    describe_step,
    Difference,
    difference,
    floored,
    in_units,
)
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.chi_squared import exceedance, FALSE_ALARM, quantile
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.result import CalibrationResult

# The year 2000: clocks that were never set start in 1970, GPS time in 1980.
_FIRST_DATE_NS = 946_684_800 * 10**9

_Sums = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Entry:
    """The answer of one recording.

    Attributes
    ----------
    name : of the bag or file.
    result : the calibration, or None.
    failure : the reason if ``result`` is None, else ''.
    repeated : whether the reason is that an earlier answer is of the same recording.

    """

    name: str
    result: CalibrationResult | None
    failure: str = ''
    repeated: bool = False


@dataclass(frozen=True, eq=False)
class Stretch:
    """Consecutive answers that agree.

    Attributes
    ----------
    names : of the answers.
    T_a_b : (4, 4), their mean, weighted by the inverse covariances.
    covariance : (6, 6), of the mean.

    """

    names: tuple[str, ...]
    T_a_b: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of many answers.

    Attributes
    ----------
    entries : all, by date.
    stretches : consecutive answers that agree; empty if no mean can be formed.
    changes : the difference from each stretch to the next.
    chi_squared, degrees_of_freedom : of all answers about one common mean.
    noise_ratio : ratio of the scatter to the stated standard deviations, at least 1.

    """

    entries: tuple[Entry, ...]
    stretches: tuple[Stretch, ...]
    changes: tuple[Difference, ...]
    chi_squared: float
    degrees_of_freedom: int
    noise_ratio: float

    @property
    def exit_status(self) -> int:
        """Return 0 if the answers agree, else 4."""
        return CHANGED if self.changes or not self.stretches else DONE

    @property
    def probability(self) -> float:
        """Return the p-value of the hypothesis that all answers are of one extrinsic."""
        return exceedance(self.chi_squared, self.degrees_of_freedom)

    @property
    def spans(self) -> list[tuple[str, str]]:
        """Return the abbreviated names of the stretches before and after each change."""
        return list(pairwise(span_of(item.names) for item in self.stretches))

    def describe(self) -> list[str]:
        """Return the verdict, one sentence a line."""
        answers = sum(entry.result is not None for entry in self.entries)
        ratio = f'chi2/dof {self.chi_squared / self.degrees_of_freedom:.2g}'
        lines = [
            f'CHANGED: {before} | {after}: {describe_step(change.step, change.named)} '
            f'({in_sigmas(change.sigma)} sigma, '
            f'chi2/dof {change.chi_squared / change.degrees_of_freedom:,.0f})'
            for (before, after), change in zip(self.spans, self.changes, strict=True)]
        if not self.stretches:
            lines.append(
                f'CONTRADICTION: the {answers} answers scatter {self.noise_ratio:.1f} times '
                f'as much as their standard deviations ({ratio}), and no single change explains '
                'it. Different vehicles, or wrong settings in some? No mean is formed')
        if len(self.stretches) == 1:
            lines.append(f'AGREE: {answers} answers are of one extrinsic ({ratio})')
        if self.stretches and self.noise_ratio > 1.5:
            lines.append(
                f'standard deviations enlarged {self.noise_ratio:.1f} times: successive answers '
                'scatter that much')
        lines += [f'{entry.name}: {entry.failure}' for entry in self.entries if entry.repeated]
        undated = answers - sum(_minute(entry) is not None for entry in self.entries)
        if 0 < undated < answers:
            lines.append(f'{undated} of {answers} without a date (a clock that was not set?): '
                         'kept in the given order')
        failed = sum(entry.result is None and not entry.repeated for entry in self.entries)
        if failed:
            lines.append(f'{failed} of {len(self.entries)} gave no answer')
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            'exit_status': self.exit_status,
            'sentences': self.describe(),
            'chi_squared': self.chi_squared,
            'degrees_of_freedom': self.degrees_of_freedom,
            'probability': self.probability,
            'noise_ratio': self.noise_ratio,
            'changes': [
                {'before': before, 'after': after, **change.to_dict()}
                for (before, after), change in zip(self.spans, self.changes, strict=True)],
            'stretches': [{
                'names': list(item.names),
                'translation_m': item.T_a_b[:3, 3].tolist(),
                'rotation_xyzw': se3.rotation_to_quaternion(item.T_a_b[:3, :3]).tolist(),
                **in_units('std_', np.sqrt(np.diagonal(item.covariance))),
            } for item in self.stretches],
            'rows': [row(entry) for entry in self.entries],
        }


COLUMNS = (
    'name', 'start_utc', 'x_m', 'y_m', 'z_m', 'roll_deg', 'pitch_deg', 'yaw_deg', 'x_std_m',
    'y_std_m', 'z_std_m', 'rotation_x_std_deg', 'rotation_y_std_deg', 'rotation_z_std_deg',
    'unobserved', 'scale', 'time_offset_s', 'residual_m', 'residual_deg', 'motions', 'findings',
    'failure')


def row(entry: Entry) -> dict[str, Any]:
    """Return one row of the table, by ``COLUMNS``; cells without a value are None."""
    cells: dict[str, Any] = dict.fromkeys(COLUMNS)
    cells.update(name=entry.name, failure=entry.failure)
    result = entry.result
    if result is not None:
        std = np.asarray(result.std)
        cells.update(zip(COLUMNS[2:14], np.concatenate([
            result.T_a_b[:3, 3], np.rad2deg(se3.roll_pitch_yaw(result.T_a_b[:3, :3])),
            std[:3], np.rad2deg(std[3:])]).tolist(), strict=True))
        # Unobservable values are left out; an unobservable rotation axis affects all three angles.
        for name in result.observability.unobserved:
            cells.update({f'{name}_m': None} if name in 'xyz' else dict.fromkeys(COLUMNS[5:8]))
        cells.update(
            start_utc=result.start_utc, unobserved=', '.join(result.observability.unobserved),
            scale=result.scale, time_offset_s=result.time_offset_s,
            residual_m=result.metrics.e_rt, residual_deg=float(np.rad2deg(result.metrics.e_rR)),
            motions=result.motions,
            findings=' '.join(dict.fromkeys(finding.code for finding in result.findings)))
    return cells


def compare(entries: Sequence[Entry]) -> Comparison:
    """Compare answers and find the changes between them.

    Parameters
    ----------
    entries : sequence of Entry
        In any order: they are sorted by date here. Entries of the same minute keep their order;
        an entry without a date stays behind its predecessor.

    Raises
    ------
    ResultError
        Fewer than two answers, or answers for different frames.

    """
    ordered = _without_repeated(_by_date(entries))
    answers = [(entry.name, entry.result) for entry in ordered if entry.result is not None]
    if len(answers) < 2:
        again = ''.join(
            f'; {entry.name}: {entry.failure}' for entry in ordered if entry.repeated)
        raise ResultError(
            f'{counted(len(answers), "answer")}, needed at least 2 of different recordings to '
            f'compare{again}')
    frames = {(result.frame_a, result.frame_b) for _, result in answers}
    if len(frames) > 1:
        pairs = '; '.join(f'{b} in {a}' for a, b in sorted(frames))
        raise ResultError(f'answers for different frames cannot be compared: {pairs}')
    results = [result for _, result in answers]
    if any(result.covariance is None for result in results):
        raise ResultError('an answer has no covariance to compare with; calibrate again')
    config = results[0].config
    covariances = [floored(np.asarray(result.covariance)) for result in results]
    # The reference of the steps: the most precise answer, with a radian weighted like a metre.
    base = results[int(np.argmin([np.trace(P) for P in covariances]))].T_a_b
    limits = limits_of(config)
    steps = np.array([aligned_step(base, result.T_a_b, P, limits)
                      for result, P in zip(results, covariances, strict=True)])
    noise_ratio = _noise_ratio(results, covariances)
    sums = _running_sums(steps, np.linalg.inv(np.array(covariances)) / noise_ratio**2)
    # Half of the false-alarm probability; the other half is for the single axes of each change.
    penalty = quantile(6, 0.5 * FALSE_ALARM / (len(results) - 1))
    edges = _partition(sums, penalty)
    chi_squared = float(_mean(sums, 0, len(results))[2]) * noise_ratio**2
    dof = int(sum((np.sqrt(np.diagonal(P)) <= limits).sum() for P in covariances)) - 6
    names = [name for name, _ in answers]
    stretches = [
        Stretch(tuple(names[i:j]), se3.moved(base, mean), P)
        for i, j in pairwise(edges) for mean, P, _ in [_mean(sums, i, j)]]
    changes = tuple(
        difference((one.T_a_b, one.covariance), (two.T_a_b, two.covariance), config,
                   FALSE_ALARM / (len(results) - 1))
        for one, two in pairwise(stretches))
    # A scatter beyond twice the stated standard deviations is no noise: no mean is formed.
    if noise_ratio > 2 and not changes:
        stretches = []
    return Comparison(tuple(ordered), tuple(stretches), changes, chi_squared, max(dof, 1),
                      noise_ratio)


def _by_date(entries: Sequence[Entry]) -> list[Entry]:
    minutes = list(accumulate(
        map(_minute, entries), lambda before, own: before if own is None else own, initial=0))
    order = sorted(range(len(entries)), key=lambda k: (
        entries[k].result is None, minutes[k + 1]))
    return [entries[k] for k in order]


def _minute(entry: Entry) -> int | None:
    """Return the start of an answer's data, minutes since 1970; None without a valid date."""
    start_ns = None if entry.result is None else entry.result.start_ns
    return None if start_ns is None or start_ns < _FIRST_DATE_NS else start_ns // (60 * 10**9)


def _without_repeated(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries with no result if an earlier one is of the same recording.

    The errors of both are the same, so the second one is no independent evidence.
    """
    first: dict[tuple[str, str, str], Entry] = {}
    unique = []
    for entry in entries:
        result, earlier = entry.result, entry
        if result is not None and result.recording is not None:
            earlier = first.setdefault((result.frame_a, result.frame_b, result.recording), entry)
        unique.append(entry if earlier is entry else Entry(
            entry.name, None, f'same recording as {earlier.name}, counted once', repeated=True))
    return unique


def _noise_ratio(
    results: Sequence[CalibrationResult], covariances: Sequence[FloatArray],
) -> float:
    """Return the ratio of the differences of successive answers to their std, at least 1."""
    # Too few answers to estimate their scatter.
    if len(results) < 6:
        return 1.0
    ratios = []
    for one, two in pairwise(zip((result.T_a_b for result in results), covariances, strict=True)):
        step = difference(one, two, results[0].config)
        ratios.append(step.chi_squared / quantile(step.degrees_of_freedom, 0.5))
    # The median is robust against a few changes.
    return float(np.sqrt(max(1.0, np.median(ratios))))


def _running_sums(steps: FloatArray, information: FloatArray) -> _Sums:
    """Return cumulative sums for (N, 6) steps x with (N, 6, 6) information matrices W.

    Of W, (N + 1, 6, 6), of W x, (N + 1, 6), and of x^T W x, (N + 1,); each starts with zero.
    """
    weighted = np.einsum('kij,kj->ki', information, steps)
    squares = np.einsum('ki,ki->k', weighted, steps)
    one, two, three = (
        np.concatenate([np.zeros((1, *each.shape[1:])), np.cumsum(each, axis=0)])
        for each in (information, weighted, squares))
    return one, two, three


def _mean(sums: _Sums, start: int | NDArray[np.intp], end: int) -> _Sums:
    """Return the (6,) mean of the steps [start, end), its (6, 6) covariance, and chi-squared.

    With (M,) starts, each has a leading dimension of M.
    """
    information, weighted, squares = (each[end] - each[start] for each in sums)
    P = np.linalg.inv(information)
    mean = np.einsum('...ij,...j->...i', P, weighted)
    return (mean, 0.5 * (P + np.swapaxes(P, -1, -2)),
            np.maximum(0.0, squares - np.sum(mean * weighted, axis=-1)))


def _partition(sums: _Sums, penalty: float) -> list[int]:
    """Return the edges of the stretches: 0, each change, the number of answers."""
    best, last = np.array([-penalty]), [0]
    for end in range(1, len(sums[0])):
        costs = best + _mean(sums, np.arange(end), end)[2] + penalty
        last.append(int(np.argmin(costs)))
        best = np.append(best, costs[last[end]])
    edges = [len(last) - 1]
    while edges[-1] > 0:
        edges.append(last[edges[-1]])
    return edges[::-1]


def span_of(names: Sequence[str]) -> str:
    """Return several names abbreviated: 'fleet0-7' for fleet0 ... fleet7."""
    if len(names) == 1:
        return names[0]
    first, last = names[0], names[-1]
    matches = [re.fullmatch(r'(.*?)(\d+)(\D*)', name) for name in names]
    ends = {(match[1], match[3]) for match in matches if match}
    numbers = [match[2] for match in matches if match]
    if len(ends) == 1 and len(numbers) == len(names) and (
            numbers == sorted({*numbers}, key=int)):
        ((before, after),) = ends
        return f'{before}{numbers[0]}-{numbers[-1]}{after}'
    return f'{first}, {last}' if len(names) == 2 else f'{first} ... {last}'


def short_names(paths: Sequence[str]) -> list[str]:
    """Return unique short names for paths: the file names, the folder names, or the paths."""
    stems = [re.sub(r'(?<=.)(\.(ya?ml|mcap|db3|bag|tum))+$', '', path.rstrip('/'))
             for path in paths]
    names = [Path(stem).name for stem in stems]
    if len({*names}) == len(names):
        return names
    parents = [Path(stem).parent.name for stem in stems]
    return parents if len({*parents}) == len(parents) else stems

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reader of saved results of pairs, from which a rig is fused without trajectories."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import ConfigError, counted, ResultError
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.storage import natural_key

# Most files that a finding names.
_NAMED = 3


def read_results(
    paths: Iterable[Path], folder: Path,
) -> tuple[list[CalibrationResult], tuple[Finding, ...]]:
    """Return the latest result of each pair, and findings about results that are not used.

    The latest one is of the recording that ended last; without times, or if equal, the file with
    the highest number in its name. Raises ConfigError if no file in ``folder`` has a result.
    """
    found: dict[frozenset[str], list[tuple[Path, CalibrationResult]]] = {}
    failures = []
    for path in sorted(paths, key=natural_key):
        try:
            result = CalibrationResult.load(path)
        except ResultError as error:
            failures.append(str(error))
            continue
        found.setdefault(frozenset((result.frame_a, result.frame_b)), []).append((path, result))
    if not found:
        raise ConfigError(
            f'{folder} is no folder; needed one with results' if not folder.is_dir() else
            f'{folder} holds no results: {failures[0]}' if failures else
            f'{folder} holds no .yaml; needed results that calibrate or a node saved')
    # Among equal ends max() takes the first, here the last file.
    used = {pair: max(reversed(items), key=lambda item: _end_ns(item[1]))
            for pair, items in found.items()}
    findings = [
        Finding('rig-result-repeated', (
            f'{counted(len(items), "result")} of {result.frame_a} - {result.frame_b}: the latest '
            f'was used, {path.relative_to(folder)}'), {'results': len(items)})
        for pair, items in found.items() if len(items) > 1 for path, result in [used[pair]]]
    if failures:
        more = f' and {len(failures) - _NAMED} more' if len(failures) > _NAMED else ''
        findings.append(Finding(
            'rig-result-unread', f'not read: {"; ".join(failures[:_NAMED])}{more}',
            {'files': len(failures)}))
    return [result for _, result in used.values()], tuple(findings)


def _end_ns(result: CalibrationResult) -> float:
    """Return the time at which the data of a result end, -inf if unknown."""
    if result.start_ns is None:
        return float('-inf')
    return result.start_ns + round(1e9 * (result.duration_s or 0.0))

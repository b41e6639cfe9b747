# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Format a result and an inspection for a terminal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from trajectory_calibration.assessment.observability import deviations_of
from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.errors import counted, in_sigmas
from trajectory_calibration.geometry import se3
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows, error_text, fixed, Row, TO_DEGREES
from trajectory_calibration.outputs.terminal import Terminal
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.solvers.solution import UNOBSERVED_STD

# Findings that are shown without -v.
_MAX_FINDINGS = 3


def format_result(
    result: CalibrationResult, T_a_b_true: FloatArray | None = None, *, verbose: bool = False,
    terminal: Terminal | None = None,
) -> str:
    """Return the text for a result: the answer, then the findings.

    ``T_a_b_true``, (4, 4), adds the error of each number; ``verbose`` all findings and details.
    """
    terminal = terminal or Terminal()
    rows = answer_rows(result, T_a_b_true)
    a, b, config = result.frame_a, result.frame_b, result.config
    lines = [terminal.paint(f'Pose of {b} in {a}', 'head')
             + terminal.paint(f'   p_{a} = T p_{b}', 'soft'), *_answer(rows, terminal)]
    if T_a_b_true is not None:
        lines.append('  error against the ground truth: ' + error_text(
            result.T_a_b, T_a_b_true, result.observability.status))
    prior = '; prior: given beforehand' if 'prior' in result.observability.status.values() else ''
    legend = (f'+-: 1 standard deviation. ok: at most {config.weak_translation:g} m, '
              f'{config.weak_rotation:g} deg; weak: more; unknown: not determined{prior}.')
    lines += [terminal.paint(line, 'soft') for line in terminal.wrapped(legend, '  ', '  ')]
    # Weak directions come last: the table shows them already.
    lines += finding_lines(
        sorted(result.findings, key=lambda found: found.code == 'direction-weak'), terminal,
        None if verbose else _MAX_FINDINGS)
    if verbose:
        lines += ['', *terminal.aligned(details(result))]
    return '\n'.join(lines) + '\n'


def format_transform(result: CalibrationResult) -> str:
    """Return 'x y z qx qy qz qw' in one line, with 'unknown' for unobservable numbers."""
    return ' '.join(transform_texts(result, 9, 9)) + '\n'


def transform_texts(result: CalibrationResult, digits: int, quaternion_digits: int) -> list[str]:
    """Return x, y, z, qx, qy, qz, qw as text, 'unknown' if unobservable."""
    rows = answer_rows(result)
    words = [fixed(row.value, digits) if row.is_known else row.word for row in rows[:3]]
    known = all(row.is_known for row in rows[3:])
    return words + [fixed(value, quaternion_digits) if known else 'unknown'
                    for value in se3.rotation_to_quaternion(result.T_a_b[:3, :3])]


def _answer(rows: tuple[Row, ...], terminal: Terminal) -> list[str]:
    """Return the six numbers in columns, aligned at the decimal point."""
    parts = [row.value_text.partition('.') for row in rows]
    before = max([len(whole) for whole, point, _ in parts if point] + [4])
    after = max([len(digits) for _, _, digits in parts] + [3])
    lines = []
    for row, (whole, point, digits) in zip(rows, parts, strict=True):
        shown = (f'{whole:>{before}}.{digits:<{after}}' if point else
                 whole.rjust(before + after + 1))
        std = f'+- {row.std_text}' if row.std_text else ''
        unit = row.unit if row.is_known else ''
        line = f'  {row.name:<5} {shown} {std:<{after + 6}} {unit:<3}  '
        line += terminal.paint(f'{row.word:<7}', row.word)
        if row.error_text:
            line += f'  error {row.error_text} {row.unit}'
        if row.sigma is not None:
            ratio = in_sigmas(row.sigma, 1)
            line += f' {ratio} sigma' if ratio.startswith('>') else f' = {ratio} sigma'
        lines.append(line.rstrip())
    return lines


def finding_lines(findings: Iterable[Finding], terminal: Terminal, most: int | None) -> list[str]:
    """Return a blank line, the ``most`` worst findings, and the number of the others."""
    ordered = worst_first(findings)
    lines = ['']
    for found in ordered[:most]:
        head = f'{found.level}:'
        first, *rest = terminal.wrapped(f'{head} {" ".join(found.text.split())}', '', '  ')
        lines += [terminal.paint(head, found.level) + first[len(head):], *rest]
    if most is not None and len(ordered) > most:
        lines.append(f'and {len(ordered) - most} more: -v')
    return lines if ordered else []


def details(result: CalibrationResult) -> dict[str, str]:
    """Return the details of an answer by label: data, method, clocks, residual."""
    a, b = result.frame_a, result.frame_b
    quaternion = transform_texts(result, 6, 6)[3:]
    rows = {'quaternion': 'unknown' if 'unknown' in quaternion else _named(quaternion, 'xyzw')}
    if result.covariance is not None:
        words = std_texts(result.covariance)
        rows['translation std'] = f'{_named(words[:3])} m, along the axes of {a}'
        rows['rotation std'] = f'{_named(words[3:])} deg, about the axes of {a}'
    reference = result.reference or result.config.reference
    rows['fit residual'] = (
        f'{result.metrics.e_rt:.4f} m, {np.rad2deg(result.metrics.e_rR):.3f} deg per motion '
        f'{reference_text(reference)} (not the accuracy)')
    rows['turned about'] = (f'{_turned(result.observability.excitation_deg)} deg rms per '
                            f'motion, axes of {a}')
    rows['data'] = _describe_data(result)
    diagnosis = result.diagnosis or {}
    if result.scale != 1.0:
        deviation = diagnosis.get('scale_deviation')
        # It is the standard deviation of the estimate relative to the scale of the settings.
        std = '' if deviation is None else (
            f' +- {result.config.scale * deviation / result.scale:.2%}')
        rows['scale'] = f'{result.scale:#.5g}{std}, multiplies the positions of {b}'
    if result.time_offset_s:
        rows['clock offset'] = f'{fixed(result.time_offset_s, 4)} s added to the stamps of {b}'
    if result.clock_drift:
        rows['clock drift'] = f'{1e6 * result.clock_drift:+.1f} ppm on {b}, zero in its middle'
    if diagnosis.get('jumps'):
        rows['jumps'] = f'{len(diagnosis["jumps"])} excluded'
    rows['method'] = f'{result.config.solver}, version {result.version}'
    if result.reference_choice:
        rows['reference'] = result.reference_choice
    return rows


def reference_text(reference: str) -> str:
    """Return the span of the motions of a reference: 'of 5 poses'."""
    if reference == 'B1':
        return 'from pose to pose'
    return {'B': f'of {reference[1:]} poses', 'C': f'from the first of each {reference[1:]} poses',
            }.get(reference[:1], 'from the first pose')


def std_texts(covariance: FloatArray) -> list[str]:
    """Return the six standard deviations of a (6, 6) covariance as text, metres and degrees.

    'unknown' from half of ``UNOBSERVED_STD``, the placeholder for unobservable directions.
    """
    # Written so that NaN is unknown.
    return [fixed(value, 3 if k >= 3 else 4) if value < limit else 'unknown'
            for k, (value, limit) in enumerate(zip(
                deviations_of(covariance), 0.5 * TO_DEGREES * UNOBSERVED_STD, strict=True))]


def format_inspection(found: dict[str, Any], terminal: Terminal | None = None) -> str:
    """Return the text for the inspection of one file or bag."""
    terminal = terminal or Terminal()
    lines = [found['path'], *_marked((('warning', note) for note in found['notes']), terminal)]
    for item in found['trajectories']:
        # A file holds one trajectory, which has the name of the file.
        if item['name'] != found['path']:
            lines += ['', f'{item["name"]}  ({item["kind"]})']
        messages = item.get('messages', item['poses'])
        read = '' if messages == item['poses'] else f' of {counted(messages, "message")}'
        if item['kind'].endswith('/Path'):
            read = f' in the last of {counted(messages, "message")}'
        longest = f', the longest {item["longest_gap_s"]:.3f} s' if item['gaps'] else ''
        gaps = counted(item['gaps'], 'gap') + longest if item['gaps'] else 'no gaps'
        lines += _marked(((one['level'], one['text']) for one in item['findings']), terminal)
        lines += terminal.aligned({
            'read as': item.get('read_as') or '',
            'frames': ('not named in the file' if item['sensor_frame'] is None
                       else f'{item["sensor_frame"]} in {item["world_frame"]}'),
            'poses': f'{item["poses"]:,}{read}, {item["rate_hz"]:.2f} Hz, {gaps}',
            'time': f'{item["duration_s"]:.3f} s from {item["start_s"]:.3f}',
            'path': f'{item["path_length_m"]:.2f} m',
            'turned about': f'{_turned(item["turned_deg"])} deg rms in 2 s',
            'motion': f'{item["motion"]}: {item["advice"]}',
        })
    if 'transforms' in found:
        transforms = found['transforms']
        lines += ['', 'Transforms']
        lines += terminal.aligned({
            'frames': ', '.join(transforms['frames']),
            'edges': ', '.join(transforms['edges']),
            'can serve': ', '.join(transforms['pairs']) or 'none: nothing moves',
        })
    if found['other']:
        lines += ['', 'Topics that cannot serve']
        lines += terminal.aligned({
            item['topic']: item.get('error') or (
                f'{item["msgtype"]}, {counted(item["messages"], "message")}')
            for item in found['other']})
    return '\n'.join(lines) + '\n'


def _describe_data(result: CalibrationResult) -> str:
    summary = result.association
    kept = '' if result.inliers is None else f', {np.count_nonzero(result.inliers):,} kept'
    one, other = ('a', 'b') if summary.stamps_of == 'b' else ('b', 'a')
    how = (f'{one} interpolated at the stamps of {other}' if summary.method == 'interpolate'
           else 'nearest stamps')
    reasons = ((summary.in_gaps, 'in gaps'), (summary.outside, 'outside the common time'),
               (summary.between, 'between poses'))
    unused = ', '.join(f'{count} {reason}' for count, reason in reasons if count)
    return (f'{counted(result.poses, "pose pair")} ({how}) of {summary.poses_a:,} and '
            f'{summary.poses_b:,} poses, {counted(result.motions, "motion")}{kept}'
            + (f'; unused poses of {other}: {unused}' if unused else ''))


def _named(words: Iterable[str], names: str = 'xyz') -> str:
    return '  '.join(f'{name} {word}' for name, word in zip(names, words, strict=True))


def _turned(degrees: Iterable[float]) -> str:
    return _named(fixed(value, 2) for value in degrees)


def _marked(found: Iterable[tuple[str, str]], terminal: Terminal) -> list[str]:
    return [line for level, text in found
            for line in terminal.wrapped(f'{level}: {text}', '  ', '    ')]

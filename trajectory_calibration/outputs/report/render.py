# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""HTML pages of a result or of a failed calibration."""

from __future__ import annotations

from dataclasses import replace
from html import escape

import numpy as np

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.trajectory import Trajectory
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.outputs.answer import answer_rows, FAILED, TITLES
from trajectory_calibration.outputs.report.box import verdict_box
from trajectory_calibration.outputs.report.clocks import compare_clocks
from trajectory_calibration.outputs.report.data import report_data, ReportData
from trajectory_calibration.outputs.report.page import (
    asset,
    Figure,
    metres,
    next_step,
    page,
    section,
    sentence,
    verdict_section,
)
from trajectory_calibration.outputs.report.record import Record, record_cards
from trajectory_calibration.outputs.report.sections import gap_strip, NAVIGATION, rates, sections
from trajectory_calibration.outputs.report.view3d import single_track
from trajectory_calibration.result import CalibrationResult


def render_report(
    result: CalibrationResult, a: Trajectory, b: Trajectory, *,
    T_a_b_true: FloatArray | None = None, record: Record | None = None,
) -> str:
    """Return the report of a result and its trajectories.

    Raises AssociationError if these have no common time with the clock of the result.
    """
    return render(report_data(result, a, b, T_a_b_true), record)


def render(data: ReportData, record: Record | None = None) -> str:
    """Return the report as an HTML page."""
    result = data.result
    box = verdict_box(result, data.rows, data.driven)
    last = section(6, 'Record', record_cards(
        record, result.config, result.findings, result.version))
    return page(
        f'{result.frame_a} → {result.frame_b}: calibration report', box + sections(data) + last,
        navigation=NAVIGATION)


def render_box(result: CalibrationResult) -> str:
    """Return the verdict box alone, with its style, for a notebook."""
    box = verdict_box(result, answer_rows(result))
    # In an iframe, so that the style does not affect the notebook.
    inside = f'<style>{asset("page.css")} body{{background:none}}</style><main>{box}</main>'
    # The iframe takes the height of its content, if the notebook allows scripts.
    fit = 'this.style.height=this.contentDocument.documentElement.scrollHeight+&quot;px&quot;'
    return (f'<iframe srcdoc="{escape(inside)}" style="width:100%;height:460px;border:0" '
            f'title="verdict" onload="{fit}"></iframe>')


def render_failure(
    error: str, trajectories: tuple[Trajectory, ...], *, config: CalibrationConfig | None = None,
    record: Record | None = None,
) -> str:
    """Return the report of a failed calibration: error, next step and inputs.

    ``trajectories`` are those that could be read: a and b, or fewer.
    """
    # The message has the reason first, then the advice, if any.
    reason, _, advice = (error.partition('. ') if '. ' in error else
                         error.rpartition('; ') if '; ' in error else (error, '', ''))
    box = verdict_section(
        FAILED, 'Calibration failed', TITLES[FAILED],
        f'<p class="error">{escape(sentence(reason))}</p>{next_step(advice)}')
    figures = list(map(_input_figure, 'ab', trajectories))
    if len(trajectories) == 2:
        figures += _together(*trajectories)
    body = section(1, 'What was found of the inputs', figures, columns=2) if figures else ''
    last = section(2, 'Record', record_cards(record, config or CalibrationConfig(), [
        found for trajectory in trajectories for found in trajectory.findings]))
    return page('Calibration failed', box + body + last, navigation=('Inputs', 'Record'))


def _input_figure(name: str, trajectory: Trajectory) -> Figure:
    length = metres(float(np.sum(np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1))))
    angle = float(np.rad2deg(np.sum(np.linalg.norm(trajectory.turns, axis=1))))
    reading = (f'{len(trajectory):,} poses over {trajectory.duration_s:.1f} s '
               f'({1e9 / trajectory.usual_step_ns:.3g} Hz), path {length}, turned '
               f'{angle:,.0f} deg in all.')
    return Figure('input', single_track(trajectory.positions, f'line-{name}'), reading,
                  names={'name': name, 'frame': trajectory.sensor_frame})


def _together(a: Trajectory, b: Trajectory) -> list[Figure]:
    clocks = compare_clocks(a, b)
    delay = (int(b.stamps_ns[0]) - int(a.stamps_ns[0])) * 1e-9
    strip = Figure('times of inputs', gap_strip(clocks),
                   f'The first pose of b is {delay:+.3f} s from that of a.')
    reading = 'Both sensors of one vehicle turn by the same angle at the same time.'
    if a.stamps_ns[-1] <= b.stamps_ns[0] or b.stamps_ns[-1] <= a.stamps_ns[0]:
        # Without a common time both start at their first pose, to see whether it is one drive.
        clocks = compare_clocks(
            a, replace(b, stamps_ns=b.stamps_ns - b.stamps_ns[0] + a.stamps_ns[0]))
        reading += ' Drawn from the first pose of each, because they have no time in common.'
    return [strip, Figure('rates of inputs', rates(clocks), reading,
                          [('a', a.sensor_frame), ('b', b.sensor_frame)])]

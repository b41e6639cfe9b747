# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration: one self-contained HTML page with answer, figures and record."""

from trajectory_calibration.outputs.report.record import hash_inputs, Record
from trajectory_calibration.outputs.report.render import (
    render_box,
    render_failure,
    render_report,
)

__all__ = ['Record', 'hash_inputs', 'render_box', 'render_failure', 'render_report']

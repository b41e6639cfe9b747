# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The transform and its inverse in the formats of other tools, ready to be copied."""

from __future__ import annotations

from html import escape

from trajectory_calibration.errors import CalibrationError
from trajectory_calibration.outputs.exports import EXPORTS
from trajectory_calibration.outputs.placement import Placement
from trajectory_calibration.result import CalibrationResult

FORMATS = {
    'urdf': 'URDF', 'static-tf': 'static transform', 'autoware': 'Autoware', 'kalibr': 'Kalibr',
    'matrix': '4 × 4', 'tum': 'TUM', 'yaml': 'YAML',
}


def copies(result: CalibrationResult) -> str:
    """Return tabs with text to copy; they work without JavaScript, which adds the button."""
    forward = Placement.of(result)
    if forward.kept_back:
        return ('<div class="copies"><h3>Copy as</h3><p class="lead">Nothing yet: '
                f'{escape(forward.kept_back)} is unknown.</p></div>')
    tabs, panels = [], []
    for k, (name, title) in enumerate(FORMATS.items()):
        try:
            texts = [EXPORTS[name].write(item) for item in (forward, forward.inverted())]
        except CalibrationError:
            # Two frames of one name have no place in a tree.
            continue
        words = EXPORTS[name].sentence
        tabs.append(
            f'<input type="radio" name="format" id="f-{name}"{" checked" if k == 0 else ""}>'
            f'<label for="f-{name}">{title}</label>')
        panels.append(
            f'<div class="panel" id="p-{name}"><p>{escape(words[:1].upper() + words[1:])}.</p>'
            f'<pre class="forward">{escape(texts[0])}</pre>'
            f'<pre class="inverse">{escape(texts[1])}</pre></div>')
    if not panels:
        return ''
    a, b = escape(result.frame_a), escape(result.frame_b)
    return (
        '<div class="copies"><h3>Copy as</h3><div class="tabs">'
        f'{"".join(tabs)}<span class="space"></span>'
        '<input type="checkbox" id="inverse"><label for="inverse">inverse '
        f'<small>({a} in {b})</small></label></div>{"".join(panels)}</div>')

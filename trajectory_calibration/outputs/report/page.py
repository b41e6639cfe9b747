# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frame of a report: one file with its style and scripts inside, and nothing from outside."""

from __future__ import annotations

from functools import cache
from html import escape
from importlib.resources import files

from trajectory_calibration.outputs.report.copies import FORMATS


@cache
def _asset(name: str) -> str:
    return (files(__package__) / name).read_text(encoding='utf-8')


def style() -> str:
    """Return the style sheet."""
    chosen = ','.join(
        f'.copies:has(#f-{name}:checked) #p-{name}' for name in FORMATS)
    return _asset('page.css').replace('FORMAT_RULES', f'{chosen}{{display:block}}')


def page(
    title: str, sections: str, *, navigation: tuple[str, ...] = (), made_by: str = '',
    scripts: tuple[str, ...] = ('page.js', 'view3d.js'),
) -> str:
    """Return a whole page."""
    links = ''.join(f'<a href="#s{k}">{k} {escape(name)}</a>'
                    for k, name in enumerate(navigation, 1))
    script = f'<script>{"".join(map(_asset, scripts))}</script>' if scripts else ''
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f'<meta name="generator" content="{escape(made_by)}"><title>{escape(title)}</title>'
        f'<link rel="icon" href="data:,"/><style>{style()}</style></head><body><main>'
        f'<header class="top"><span>Extrinsic calibration report</span><nav>{links}</nav>'
        f'</header>{sections}</main>{script}</body></html>\n')

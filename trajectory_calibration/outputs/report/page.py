# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The frame of a report: one file with its style and scripts inside, and nothing from outside."""

from __future__ import annotations

from html import escape
from importlib.resources import files
import platform
from string import Template

import numpy as np

from trajectory_calibration.version import __version__

# Formats to copy, and what stands on their tabs.
FORMATS = {
    'urdf': 'URDF', 'static-tf': 'static transform', 'autoware': 'Autoware', 'kalibr': 'Kalibr',
    'matrix': '4 × 4', 'tum': 'TUM', 'yaml': 'YAML',
}


def asset(name: str) -> str:
    """Return the text of a file beside this module."""
    return (files(__package__) / name).read_text(encoding='utf-8')


def filled(name: str, **texts: str) -> str:
    """Return a template beside this module with its gaps filled by HTML."""
    return Template(asset(name)).substitute(texts)


def versions() -> str:
    """Return the versions that an answer may depend on."""
    return (f'trajectory_calibration {__version__}, Python {platform.python_version()}, '
            f'NumPy {np.__version__}, {platform.system()} {platform.machine()}')


def style() -> str:
    """Return the style sheet."""
    chosen = ','.join(
        f'.copies:has(#f-{name}:checked) #p-{name}' for name in FORMATS)
    return asset('page.css').replace('FORMAT_RULES', f'{chosen}{{display:block}}')


def page(
    title: str, sections: str, *, navigation: tuple[str, ...] = (),
    scripts: tuple[str, ...] = ('page.js', 'view3d.js'),
) -> str:
    """Return a whole page."""
    links = ''.join(f'<a href="#s{k}">{k} {escape(name)}</a>'
                    for k, name in enumerate(navigation, 1))
    script = f'<script>{"".join(map(asset, scripts))}</script>' if scripts else ''
    return filled('page.html', title=escape(title), made_by=escape(versions()), style=style(),
                  links=links, sections=sections, script=script)

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The documentation site: ``make docs`` builds it with warnings as errors."""

from pathlib import Path
import re

_VERSION = Path(__file__).resolve().parents[1] / 'trajectory_calibration' / 'version.py'

project = 'trajectory_calibration'
author = 'trajectory_calibration maintainers'
copyright = 'trajectory_calibration maintainers, Apache-2.0'  # noqa: A001 (Sphinx's name)
version = release = re.search(r"'(.+)'", _VERSION.read_text(encoding='utf-8'))[1]

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon', 'sphinx.ext.mathjax']
myst_enable_extensions = ['dollarmath', 'deflist']
myst_heading_anchors = 4
source_suffix = {'.md': 'markdown'}
exclude_patterns = ['build', '**.ipynb', 'benchmark/summary.md']
# Links to files of the repository that are no pages of the site (../config/calibration.yaml).
suppress_warnings = ['myst.xref_missing', 'myst.header', 'misc.highlighting_failure']

autodoc_member_order = 'bysource'
autodoc_typehints = 'signature'
autodoc_type_aliases = {'ArrayLike': 'ArrayLike'}
# Needed on a vehicle, not for the pages.
autodoc_mock_imports = ['rclpy', 'casadi']

html_theme = 'furo'
html_title = f'trajectory_calibration {release}'
html_static_path = []


def setup(app):
    """Take part in the reading of docstrings."""
    app.connect('autodoc-process-docstring', _attributes_as_list, priority=400)


def _attributes_as_list(*event):
    """Make a list of 'Attributes', where napoleon reads the text behind a name as its type."""
    lines = event[-1]
    if 'Attributes' not in lines:
        return
    start = lines.index('Attributes')
    listed = []
    for line in lines[start + 2:]:
        names, colon, text = line.partition(' : ')
        if line.startswith(' ') or not line:
            listed.append(f'  {line.strip()}'.rstrip())
        elif colon:
            listed.append(f'- **{names}**: {text}')
        else:
            break
    lines[start:start + 2 + len(listed)] = ['', *listed, '']

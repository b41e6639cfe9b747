# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The record of a report: inputs with checksums, command, settings, versions and findings."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import hashlib
from html import escape
from pathlib import Path
from typing import NamedTuple

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.data.findings import Finding, worst_first
from trajectory_calibration.outputs.report.page import asset, table, versions

_BLOCK = 1 << 20


class Record(NamedTuple):
    """The command that repeats a calibration, '' from Python, and its input files.

    Each input has role, name, size in bytes and SHA-256.
    """

    command: str = ''
    inputs: tuple[tuple[str, str, str, str], ...] = ()


def hash_inputs(
    paths: Iterable[tuple[str, Path]], progress: Callable[[int, int], None] | None = None,
) -> tuple[tuple[str, str, str, str], ...]:
    """Return the ``inputs`` of a record for (role, path); a folder is replaced by its files.

    ``progress`` is called with the number of bytes read so far, and the total.
    """
    files = [(role, item) for role, path in paths for item in (
        sorted(item for item in path.rglob('*') if item.is_file()) if path.is_dir() else [path])]
    total = sum(item.stat().st_size for _, item in files if item.exists())
    found, done = [], 0
    for role, item in files:
        digest, size = hashlib.sha256(), 0
        try:
            with item.open('rb') as stream:
                while block := stream.read(_BLOCK):
                    digest.update(block)
                    size += len(block)
                    if progress is not None:
                        progress(done + size, max(total, done + size))
            found.append((role, str(item), f'{size:,}', digest.hexdigest()))
        except OSError as error:
            found.append((role, str(item), '0', f'not readable: {error.strerror}'))
        done += size
    return tuple(found)


def record_cards(
    record: Record | None, config: CalibrationConfig, findings: Iterable[Finding],
    result_version: str = '',
) -> list[str]:
    """Return the cards of inputs, command, settings, versions, findings and glossary."""
    command, inputs = record or Record()
    rows = ''.join(
        f'<li><span class="level {found.level}">{found.level}</span><code>{found.code}</code>'
        f'<span>{escape(found.text)}</span></li>' for found in worst_first(findings))
    made_by = f'; result made by {escape(result_version)}' if result_version else ''
    cards = {
        'Findings': f'<ul class="findings">{rows}</ul>' if rows else '<p>None.</p>',
        'Inputs': table(('sensor', 'file', 'bytes', 'SHA-256'), inputs) if inputs else '',
        'Command to repeat it': f'<pre>{escape(command)}</pre>' if command else '',
        'Settings': _settings(config),
        'Versions': f'<p>{escape(versions())}{made_by}</p>',
        'Glossary': asset('glossary.html'),
    }
    return [f'<div class="card"><h3>{title}</h3>{inside}</div>'
            for title, inside in cards.items() if inside]


def _settings(config: CalibrationConfig) -> str:
    rows = [(option.name, *(str(value) or '–' for value in (
        getattr(config, option.name), option.default))) for option in config.options()]
    changed = [row for row in rows if row[1] != row[2]]
    unchanged = [row[:2] for row in rows if row[1] == row[2]]
    head = ('setting', 'value', 'default')
    first = table(head, changed) if changed else '<p>Defaults.</p>'
    return (f'{first}<details><summary>{"All other" if changed else "All"} settings</summary>'
            f'{table(head[:2], unchanged)}</details>')

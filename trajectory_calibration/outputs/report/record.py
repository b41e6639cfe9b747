# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a calibration was made of: enough to repeat it, or to tell that it was another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
import hashlib
from html import escape
from pathlib import Path
from typing import Any

from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.outputs.report.page import asset, versions
from trajectory_calibration.outputs.report.text import table

_BLOCK = 1 << 20


@dataclass(frozen=True)
class Input:
    """One input file: its role, name, size in bytes and SHA-256."""

    role: str
    name: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Record:
    """Where a report comes from.

    Attributes
    ----------
    command : the command line that repeats it; empty where it was made from Python.
    inputs : the files that were read.

    """

    command: str = ''
    inputs: tuple[Input, ...] = field(default=())


def hash_inputs(paths: Iterable[tuple[str, Path]]) -> tuple[Input, ...]:
    """Return the inputs of (role, path); of a folder, a bag, its files one by one."""
    found = []
    for role, path in paths:
        files = sorted(item for item in path.rglob('*') if item.is_file()) \
            if path.is_dir() else [path]
        for item in files:
            digest = hashlib.sha256()
            try:
                with item.open('rb') as stream:
                    while block := stream.read(_BLOCK):
                        digest.update(block)
                found.append(Input(role, str(item), item.stat().st_size, digest.hexdigest()))
            except OSError as error:
                found.append(Input(role, str(item), 0, f'not readable: {error.strerror}'))
    return tuple(found)


def record_cards(
    record: Record, config: CalibrationConfig, findings: str, result_version: str = '',
) -> str:
    """Return the cards of inputs, command, settings, versions, findings and glossary."""
    cards = [_card('Findings', findings)]
    if record.inputs:
        cards.append(_card('Inputs', table(
            ('sensor', 'file', 'bytes', 'SHA-256'),
            [(item.role, item.name, f'{item.size:,}', item.sha256) for item in record.inputs])))
    if record.command:
        cards.append(_card('Command to repeat it', f'<pre>{escape(record.command)}</pre>'))
    cards += [
        _card('Settings', _settings(config)),
        _card('Versions', f'<p>{escape(versions())}'
              + (f'; result made by {escape(result_version)}' if result_version else '') + '</p>'),
        _card('Glossary', asset('glossary.html'))]
    return ''.join(cards)


def _card(title: str, inside: str) -> str:
    return f'<div class="card"><h3>{title}</h3>{inside}</div>'


def _settings(config: CalibrationConfig) -> str:
    changed: list[tuple[str, ...]] = []
    usual: list[tuple[str, ...]] = []
    for option in config.options():
        value: Any = getattr(config, option.name)
        row = (option.name, _shown(value), _shown(option.default))
        (usual if value == option.default else changed).append(row)
    head = ('setting', 'value', 'default')
    first = table(head, changed) if changed else '<p>Defaults.</p>'
    return (f'{first}<details><summary>{"All other" if changed else "All"} settings</summary>'
            f'{table(head[:2], [row[:2] for row in usual])}</details>')


def _shown(value: Any) -> str:
    return '–' if value == '' else str(value)

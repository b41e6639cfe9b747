# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""The results file: tidy CSV that grows task by task and survives being cut off anywhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
import csv
from dataclasses import asdict, astuple, fields, replace
import io
import json
from pathlib import Path
from typing import Any

from benchmarks.paper.tasks import Record, references_of, SETTINGS, Task
from trajectory_calibration.errors import ResultError
from trajectory_calibration.version import __version__

COLUMNS = tuple(item.name for item in fields(Record))

_KINDS: dict[str, Any] = {'str': str, 'float': float, 'int': int}
_READERS = tuple(_KINDS[str(item.type)] for item in fields(Record))

_RunKey = tuple[str, str, float, int]


class ResultStore:
    """Records of finished calibrations in ``runs.csv``, and what they depend on beside it.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.

    Raises
    ------
    ResultError
        The folder cannot be written, or holds results of another version or other settings.

    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / 'runs.csv'
        self._made_by = {'version': __version__, 'settings': SETTINGS}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._require_same_settings(folder / 'settings.json')
            self._records = self._recover()
        except OSError as error:
            raise ResultError(f'{folder} cannot be used for results: {error.strerror or error}; '
                              'give another --output') from error

    def missing(self, tasks: Iterable[Task]) -> list[Task]:
        """Return what is left of the tasks: those with solvers that have no results yet."""
        left = []
        for task in tasks:
            done = self._records.get(_key(task), {})
            solvers = tuple(solver for solver in task.solvers if solver not in done)
            if solvers:
                left.append(replace(task, solvers=solvers))
        return left

    def append(self, records: Sequence[Record]) -> None:
        """Add the records of a task, in one write that reaches the disk's cache at once."""
        text = _to_csv(records)
        try:
            with self.path.open('a', encoding='utf-8', newline='') as stream:
                stream.write(text)
        except OSError as error:
            raise ResultError(f'{self.path} cannot be written: {error.strerror or error}; what is '
                              'in it stays, and the same command continues') from error
        # As they will be read again: a run that was cut off ends in the same figures.
        self._add(_from_csv(io.StringIO(text)))

    def select(self, tasks: Iterable[Task]) -> list[Record]:
        """Return the records of the tasks and of their solvers, in their order."""
        return [record for task in tasks for solver in task.solvers
                for record in self._records.get(_key(task), {}).get(solver, [])]

    def _require_same_settings(self, path: Path) -> None:
        if not self.path.exists():
            path.write_text(json.dumps(self._made_by, indent=1) + '\n', encoding='utf-8')
            return
        try:
            found = json.loads(path.read_text(encoding='utf-8'))
        except (OSError, ValueError):
            found = None
        if found != self._made_by:
            raise ResultError(
                f'{self.path} was made with {found or "unknown settings"}, needed '
                f'{self._made_by}; give another --output or remove it')

    def _recover(self) -> dict[_RunKey, dict[str, list[Record]]]:
        """Read what is whole, and rewrite the file with that alone."""
        self._records = {}
        if self.path.exists():
            with self.path.open(encoding='utf-8', newline='', errors='replace') as stream:
                next(stream, None)
                self._add(_from_csv(stream))
        whole: dict[_RunKey, dict[str, list[Record]]] = {}
        for key, solvers in self._records.items():
            whole[key] = {}
            for solver, records in solvers.items():
                # Two processes that shared the folder may have written the same run twice.
                by_reference = {item.reference: item for item in records}
                if set(by_reference) == set(references_of(solver)):
                    whole[key][solver] = list(by_reference.values())
        kept = [record for solvers in whole.values() for records in solvers.values()
                for record in records]
        temporary = self.path.with_suffix('.tmp')
        temporary.write_text(','.join(COLUMNS) + '\n' + _to_csv(kept), encoding='utf-8')
        temporary.replace(self.path)
        return whole

    def _add(self, records: Iterable[Record]) -> None:
        for record in records:
            self._records.setdefault(_key(record), {}).setdefault(
                record.solver, []).append(record)


def _key(item: Task | Record) -> _RunKey:
    return item.source, item.kind, item.level, item.run


def _to_csv(records: Iterable[Record]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    for record in records:
        # Seven digits: one more than the published figures have.
        writer.writerow(f'{value:.7g}' if isinstance(value, float) else value
                        for value in astuple(record))
    return text.getvalue()


def _from_csv(lines: Iterable[str]) -> Iterator[Record]:
    for line in lines:
        # A file that lost its end in a power cut may go on with zeros.
        with suppress(csv.Error):
            yield from filter(None, map(_to_record, csv.reader([line])))


def _to_record(row: Sequence[str]) -> Record | None:
    """Return the record of a row, or None of a row that was cut off."""
    if len(row) != len(COLUMNS):
        return None
    try:
        return Record(*(read(text) for read, text in zip(_READERS, row, strict=True)))
    except ValueError:
        return None


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Write data classes of one kind as CSV with their fields as columns.

    Raises
    ------
    ResultError
        The file cannot be written.

    """
    try:
        with path.open('w', encoding='utf-8', newline='') as stream:
            writer = csv.writer(stream, lineterminator='\n')
            writer.writerow(asdict(rows[0]))
            for row in rows:
                writer.writerow(f'{value:.6g}' if isinstance(value, float) else value
                                for value in astuple(row))
    except OSError as error:
        raise ResultError(f'{path} cannot be written: {error.strerror or error}') from error

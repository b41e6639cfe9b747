# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Jobs: recordings to calibrate independently, and their results on disk.

A job with a result file is done: a run that was interrupted continues with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
import glob
import hashlib
from itertools import chain
import json
from pathlib import Path
from typing import Any
from zlib import crc32

from trajectory_calibration.config.file_names import file_names
from trajectory_calibration.config.settings import CalibrationConfig
from trajectory_calibration.config.yaml_file import make_folder, read_yaml, write_yaml
from trajectory_calibration.errors import (
    CalibrationError,
    ConfigError,
    ResultError,
    unknown_name,
)
from trajectory_calibration.executor import Executor
from trajectory_calibration.fleet.comparison import Entry, short_names
from trajectory_calibration.pipeline import calibrate
from trajectory_calibration.result import CalibrationResult
from trajectory_calibration.sources.inputs import InputOptions, load_inputs
from trajectory_calibration.sources.storage import natural_key
from trajectory_calibration.sources.text import BAG_SUFFIXES
from trajectory_calibration.version import __version__

# Digits of a fingerprint, and the number of bytes of each file that it depends on.
_DIGITS, _HASHED_BYTES = 8, 65_536

# Keys of a job, also valid beside the list of jobs as defaults; then the input options of a and b.
_JOB_KEYS = ('a', 'b', 'bag', 'name', 'config')
_KEYS = (
    *_JOB_KEYS, *(f'{item.name}_{sensor}' for item in fields(InputOptions) for sensor in 'ab'))


@dataclass(frozen=True)
class Job:
    """One recording of the two sensors.

    Attributes
    ----------
    name : of its result.
    a, b : files, or topics or ``tf:PARENT.CHILD`` of the bags.
    bags : paths; empty if a and b are files.
    config : settings of the calibration.
    options_a, options_b : how to read a and b.

    """

    name: str
    a: str
    b: str
    bags: tuple[str, ...] = ()
    config: CalibrationConfig = field(default_factory=CalibrationConfig)
    options_a: InputOptions = field(default_factory=InputOptions)
    options_b: InputOptions = field(default_factory=InputOptions)

    @cached_property
    def fingerprint(self) -> str:
        """Return 8 digits that depend on the settings, the inputs and the version.

        They do not depend on the folder of the inputs, nor on the name, which other jobs affect.
        """
        options = self.options_a, self.options_b
        topics = (self.a, self.b) if self.bags else ()
        files = []
        for path in map(Path, (*(self.bags or (self.a, self.b)),
                               *(item.times for item in options if item.times))):
            for item in sorted(path.iterdir()) if path.is_dir() else [path]:
                # A file that cannot be read gives no result that needs a fingerprint.
                with suppress(OSError), item.open('rb') as stream:
                    stat = item.stat()
                    files.append((item.name, stat.st_size, stat.st_mtime_ns,
                                  crc32(stream.read(_HASHED_BYTES))))
        text = json.dumps([
            topics, asdict(self.config), *(asdict(replace(item, times=None)) for item in options),
            files, __version__], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]

    @property
    def file_name(self) -> str:
        """Return the name of the result file."""
        return f'{self.name}-{self.fingerprint}.yaml'


def read_jobs(
    specifications: Sequence[str], a: str | None, b: str | None, config: CalibrationConfig,
) -> list[Job]:
    """Return the jobs of a YAML file, or one for each bag or folder that patterns match.

    ``specifications`` are one file ``*.yaml`` with a list ``jobs``, or paths and patterns of bags,
    or of folders with the files ``a`` and ``b``. ``a`` and ``b`` are topics or file names; those
    of the YAML file and of a job override them. ``config`` is for all jobs; ``config`` of the
    YAML file, then that of the job override it. Raises ConfigError if there are no jobs, a key
    is unknown, or a sensor is not named.
    """
    if len(specifications) == 1 and Path(specifications[0]).suffix in ('.yaml', '.yml'):
        jobs = _from_yaml(Path(specifications[0]), a, b, config)
    else:
        paths = dict.fromkeys(path for pattern in specifications for path in _expand(pattern))
        jobs = [_from_path(path, a, b, config) for path in paths]
    if not jobs:
        raise ConfigError(f'no bags match {" ".join(specifications)}')
    return [replace(job, name=name) for job, name in zip(jobs, _names(jobs), strict=True)]


def _expand(pattern: str) -> list[str]:
    paths = sorted(glob.glob(pattern, recursive=True), key=natural_key)  # noqa: PTH207
    # A missing path is kept, to be reported as a recording without an answer.
    return paths or ([] if glob.has_magic(pattern) else [pattern])


def _from_path(path: str, a: str | None, b: str | None, config: CalibrationConfig) -> Job:
    folder, given = Path(path), {'a': a, 'b': b, 'config': config}
    if not folder.is_dir() or _holds_bag(folder):
        return _from_mapping(Path(), {**given, 'bag': path})
    if a and not (folder / a).exists():
        for item in folder.iterdir():
            if _holds_bag(item):
                raise ConfigError(f"{path} is no bag, and {item.name} in it is; give '{item}'")
            if (item / a).exists():
                raise ConfigError(f"{path} holds one folder for each recording; give '{path}/*'")
    return _from_mapping(folder, given)


def _holds_bag(folder: Path) -> bool:
    return folder.is_dir() and any(item.suffix in BAG_SUFFIXES or item.name == 'metadata.yaml'
                                   for item in folder.iterdir())


def _from_yaml(
    path: Path, a: str | None, b: str | None, config: CalibrationConfig,
) -> list[Job]:
    data = read_yaml(path, 'a list of jobs', ConfigError)
    if not isinstance(data, Mapping) or not isinstance(data.get('jobs'), list):
        raise ConfigError(f'{path} holds no jobs; needed a list "jobs:", see docs/fleet.md')
    common = {'a': a, 'b': b, **{key: value for key, value in data.items() if key != 'jobs'}}
    _check(common, path)
    jobs = []
    for item in data['jobs']:
        given = item if isinstance(item, Mapping) else {'bag': item}
        _check(given, path)
        merged = {**common, **given}
        merged['config'] = CalibrationConfig.from_dict({
            **config.to_dict(), **(common.get('config') or {}), **(given.get('config') or {})})
        jobs.append(_from_mapping(path.parent, merged))
    return jobs


def _check(given: Mapping[Any, Any], path: Path) -> None:
    """Raise ConfigError if a key of a job is unknown, or its value of the wrong type."""
    for key, value in given.items():
        if key not in _KEYS:
            raise ConfigError(unknown_name(f'{path}: key', key, _KEYS))
        kind, needed = (Mapping, 'settings by name') if key == 'config' else (str, 'a text')
        for item in value if key == 'bag' and isinstance(value, list) else [value]:
            if key in _JOB_KEYS and item is not None and (
                    not isinstance(item, kind) or '\0' in item):
                raise ConfigError(f'{path}: {key} is {value!r}, needed {needed}')


def _from_mapping(folder: Path, given: Mapping[str, Any]) -> Job:
    bags = given.get('bag') or []
    bags = [str(folder / bag) for bag in ([bags] if isinstance(bags, str) else bags) if bag]
    a, b = given['a'], given['b']
    label = given.get('name') or ' '.join(bags) or folder
    if a is None or b is None:
        raise ConfigError(f'{label}: a and b are not named; give --a and --b, topics of a bag or '
                          'names of files in a folder')
    if a == b:
        raise ConfigError(f'{label}: A and B are both {a}; needed two sensors')
    if not bags:
        a, b = (str(folder / name) for name in (a, b))
    return Job(given.get('name') or '', a, b, tuple(bags), given['config'], *(
        InputOptions.from_dict(given, folder, f'_{sensor}') for sensor in 'ab'))


def _names(jobs: Sequence[Job]) -> list[str]:
    """Return unique file names for the jobs, made from their names or else their paths."""
    paths = [job.bags[0] if job.bags else job.a for job in jobs]
    short = {path: path for path, job in zip(paths, jobs, strict=True) if not job.name}
    short = dict(zip(short, short_names([*short]), strict=True))
    return file_names(
        job.name or short[path] for path, job in zip(paths, jobs, strict=True))


def calibrate_job(job: Job) -> tuple[dict[str, Any] | None, str]:
    """Return the result of one job as plain data, or None and the reason."""
    inputs = {'sensor_a': (job.a, job.options_a), 'sensor_b': (job.b, job.options_b)}
    try:
        a, b = load_inputs(inputs, job.bags).values()
        return calibrate(a, b, job.config).to_dict(), ''
    except Exception as error:  # noqa: BLE001
        # Any error: one broken bag must not stop the other jobs.
        kind = '' if isinstance(error, CalibrationError) else f'{type(error).__name__}: '
        return None, kind + ' '.join(str(error).split())


def results_of_others(folder: Path, jobs: Sequence[Job]) -> list[Path]:
    """Return the result files in a folder that are of other jobs, settings, inputs or versions."""
    own = {job.fingerprint for job in jobs}
    return [path for path, fingerprint in _results(folder) if fingerprint not in own]


def _results(folder: Path) -> list[tuple[Path, str]]:
    return [(path, path.stem[-_DIGITS:])
            for path in sorted(folder.glob(f'*-{"[0-9a-f]" * _DIGITS}.yaml'))]


def run_jobs(
    jobs: Sequence[Job], folder: Path, executor: Executor,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Entry]:
    """Calibrate the jobs that have no result in the folder; yield every job when it is done.

    Each result is written to ``Job.file_name`` at once. Jobs without an answer are repeated by
    the next run; ``results_of_others`` are deleted at the end. Raises ResultError if the folder
    cannot be written.
    """
    make_folder(folder, ResultError)
    others = results_of_others(folder, jobs)
    paths = {fingerprint: path for path, fingerprint in _results(folder)}
    saved = [Entry(job.name, _saved(paths.get(job.fingerprint))) for job in jobs]
    pending = [job for job, entry in zip(jobs, saved, strict=True) if entry.result is None]
    entries = chain((entry for entry in saved if entry.result is not None),
                    _calibrated(pending, folder, executor))
    for done, entry in enumerate(entries, 1):
        if progress is not None:
            progress(done, len(jobs))
        yield entry
    for path in others:
        path.unlink(missing_ok=True)


def _saved(path: Path | None) -> CalibrationResult | None:
    # Without a readable result, the job is calibrated again.
    with suppress(ResultError):
        return None if path is None else CalibrationResult.load(path)
    return None


def _calibrated(jobs: Sequence[Job], folder: Path, executor: Executor) -> Iterator[Entry]:
    for k, (data, reason) in executor.unordered(calibrate_job, jobs):
        name = jobs[k].name
        if data is None:
            yield Entry(name, None, reason)
            continue
        write_yaml(folder / jobs[k].file_name, data)
        yield Entry(name, CalibrationResult.from_dict(data))

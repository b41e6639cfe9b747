# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a benchmark runs on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import distributions
import os
from pathlib import Path
import platform
from typing import TypeVar

from trajectory_calibration.executor import Executor
from trajectory_calibration.version import __version__

_LIBRARIES = ('numpy', 'casadi', 'joblib')
_Item = TypeVar('_Item')
_Result = TypeVar('_Result')


def in_order(
    executor: Executor, function: Callable[[_Item], _Result], items: Sequence[_Item],
) -> Iterator[_Result]:
    """Yield the results in the order of the items, each as soon as those before it are in."""
    waiting: dict[int, _Result] = {}
    following = 0
    for number, result in executor.unordered(function, items):
        waiting[number] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def describe_executor(executor: Executor) -> str:
    """Return where tasks run, in words."""
    if executor.scheduler is not None:
        return f'Dask cluster at {executor.scheduler}'
    return f'{executor.count} processes by {executor.backend}'


def describe_machine() -> str:
    """Return processor, cores and system in one line."""
    cores = os.cpu_count()
    return f'{_processor()}, {cores} cores, {platform.system()} {platform.machine()}'


def describe_versions() -> str:
    """Return the versions of this package, of Python and of what computes, in one line."""
    installed = {item.name: item.version for item in distributions() if item.name in _LIBRARIES}
    return ', '.join([
        f'trajectory_calibration {__version__}', f'CPython {platform.python_version()}',
        *(f'{name} {installed[name]}' for name in _LIBRARIES if name in installed)])


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines()
    except OSError:
        lines = []
    names = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.processor() or 'unknown processor'

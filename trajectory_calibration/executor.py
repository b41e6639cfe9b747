# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run independent tasks on the cores of one machine or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
import os
from typing import Any, TypeVar

from trajectory_calibration.errors import CalibrationError, ConfigError, require

BACKENDS = ('joblib', 'dask')

_Item = TypeVar('_Item')
_Result = TypeVar('_Result')


@dataclass(frozen=True)
class Executor:
    """The backend that runs the tasks.

    Attributes
    ----------
    backend : 'joblib' for processes on this machine, 'dask' for a cluster.
    processes : number of processes on this machine, also of a local cluster; 0: one per core.
    scheduler : address of the scheduler of a Dask cluster; None starts a local cluster.

    """

    backend: str = BACKENDS[0]
    processes: int = 0
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ConfigError(
                f'backend {self.backend!r} is unknown; needed one of {", ".join(BACKENDS)}')
        if self.processes < 0:
            raise ConfigError(
                f'processes is {self.processes}, needed a whole number from 0 up')
        if self.scheduler is not None and self.backend != 'dask':
            raise ConfigError('a scheduler is given, but the backend is not dask; add --backend '
                              'dask')

    @property
    def count(self) -> int:
        """Return the number of processes on this machine."""
        return self.processes or os.cpu_count() or 1

    def unordered(
        self, function: Callable[[_Item], _Result], items: Sequence[_Item],
    ) -> Iterator[tuple[int, _Result]]:
        """Yield the index of each item and its result, in the order of completion.

        ``function`` must be importable from a module. Raises MissingPackageError if the backend
        is not installed, ConfigError if the cluster cannot be reached, CalibrationError if a
        process was killed.
        """
        if not items:
            # Starts no cluster and no processes.
            return
        joblib = require('joblib')
        # One thread per process: the matrices are too small for more.
        settings = {'backend': 'dask'} if self.backend == 'dask' else {
            'backend': 'loky', 'n_jobs': self.count, 'inner_max_num_threads': 1}
        with self._cluster():
            with joblib.parallel_config(**settings):
                try:
                    parallel = joblib.Parallel(return_as='generator_unordered')
                except ValueError as error:
                    if self.backend == 'dask':
                        raise ConfigError(
                            "dask needs joblib 1.4 or newer; pip install 'joblib>=1.4'") from error
                    # joblib 1.3 of Ubuntu 24.04 yields in the order of the items only.
                    parallel = joblib.Parallel(return_as='generator')
            try:
                yield from parallel(
                    joblib.delayed(_call_indexed)(function, *each) for each in enumerate(items))
            except BrokenExecutor as error:
                raise CalibrationError(
                    'a process was killed, perhaps for lack of memory; use fewer processes '
                    '(--processes of fleet, processes in RIG.yaml)'
                ) from error

    def _cluster(self) -> AbstractContextManager[Any]:
        if self.backend != 'dask':
            return nullcontext()
        distributed = require('distributed')
        if self.scheduler is None:
            return distributed.Client(
                n_workers=self.count, threads_per_worker=1, dashboard_address=None)
        try:
            return distributed.Client(self.scheduler)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f'no Dask scheduler answers at {self.scheduler}: {error}') from error


def _call_indexed(function: Callable[[_Item], _Result], index: int, item: _Item) -> tuple[
        int, _Result]:
    return index, function(item)

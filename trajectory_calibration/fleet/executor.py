# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Many independent tasks on the cores of one machine, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import import_module
import os
from typing import Any, Generic, TypeVar

from trajectory_calibration.errors import ConfigError

BACKENDS = ('joblib', 'dask')

_Item = TypeVar('_Item')
_Result = TypeVar('_Result')


@dataclass(frozen=True)
class Executor:
    """Where tasks run.

    Attributes
    ----------
    backend : 'joblib' for processes of this machine, 'dask' for a cluster.
    jobs : processes; of a cluster, those of a local one. None: one for each core.
    scheduler : address of a Dask cluster's scheduler; None starts a local cluster.

    """

    backend: str = 'joblib'
    jobs: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ConfigError(
                f'backend {self.backend!r} is unknown; needed one of {", ".join(BACKENDS)}')
        if self.jobs is not None and self.jobs < 1:
            raise ConfigError(f'jobs is {self.jobs}, needed a whole number from 1 up')
        if self.scheduler is not None and self.backend != 'dask':
            raise ConfigError('a scheduler is given, but the backend is not dask; add --backend '
                              'dask')

    def describe(self) -> str:
        """Return where tasks run, in words."""
        if self.scheduler is not None:
            return f'Dask cluster at {self.scheduler}'
        return f'{self.processes} processes by {self.backend}'

    @property
    def processes(self) -> int:
        """Return the number of processes on this machine."""
        return self.jobs or os.cpu_count() or 1

    def map(
        self, function: Callable[[_Item], _Result], items: Iterable[_Item],
    ) -> Iterator[_Result]:
        """Yield the results in the order of the items, each as soon as those before it are in.

        ``function`` is a function of a module: processes import it.

        Raises
        ------
        ConfigError
            The backend is not installed, or its cluster cannot be reached.

        """
        yield from self._run(function, items, 'generator')

    def unordered(
        self, function: Callable[[_Item], _Result], items: Iterable[_Item],
    ) -> Iterator[tuple[int, _Result]]:
        """Yield the number of each item and its result, whichever is done first; see ``map``."""
        numbered = list(enumerate(items))
        # A cluster or a pool of processes takes longer to start than there is to do.
        if numbered:
            yield from self._run(_Numbered(function), numbered, 'generator_unordered')

    def _run(
        self, function: Callable[[_Item], _Result], items: Iterable[_Item], kind: str,
    ) -> Iterator[_Result]:
        joblib = _load('joblib', 'fleet')
        calls = (joblib.delayed(function)(item) for item in items)
        if self.backend == 'dask':
            with self._connect():
                with joblib.parallel_config(backend='dask'):
                    parallel = joblib.Parallel(return_as=kind)
                yield from parallel(calls)
            return
        # One thread each: the linear algebra here is too small to share.
        with joblib.parallel_config(
                backend='loky', n_jobs=self.processes, inner_max_num_threads=1):
            parallel = joblib.Parallel(return_as=kind)
        yield from parallel(calls)

    def _connect(self) -> Any:
        distributed = _load('distributed', 'fleet')
        if self.scheduler is None:
            return distributed.Client(
                n_workers=self.processes, threads_per_worker=1, dashboard_address=None)
        try:
            return distributed.Client(self.scheduler)
        except (OSError, ValueError) as error:
            raise ConfigError(
                f'no Dask scheduler answers at {self.scheduler}: {error}') from error


@dataclass(frozen=True)
class _Numbered(Generic[_Item, _Result]):
    """A function of numbered items that keeps the numbers."""

    function: Callable[[_Item], _Result]

    def __call__(self, item: tuple[int, _Item]) -> tuple[int, _Result]:
        return item[0], self.function(item[1])


def _load(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{module} is not installed; pip install 'trajectory_calibration[{extra}]'"
        ) from error

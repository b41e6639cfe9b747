# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every failure the package raises on purpose.

A message says what was found, what was needed, and what to do next, in one line, so that the
command line can print it as it is and the node can answer a service call with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from types import ModuleType

# First names of modules that several packages share; "pip install ruamel" installs nothing.
_SHARED = {'ruamel': 'ruamel.yaml', 'backports': 'backports.zstd'}


class CalibrationError(Exception):
    """Base of all named failures: catch this one to catch them all."""


class ConfigError(CalibrationError, ValueError):
    """A setting is out of its range, misspelt, or contradicts another one."""


class TrajectoryError(CalibrationError, ValueError):
    """Stamps or poses that cannot be a trajectory: wrong shape, not finite, not rotations."""


class SourceError(CalibrationError):
    """A file or a bag cannot be read, or holds something else than what was asked for."""


class TopicError(SourceError):
    """A bag has no such topic, or its type cannot serve as a trajectory."""


class AssociationError(CalibrationError):
    """The two trajectories do not overlap in time, or share too few poses."""


class MotionError(CalibrationError):
    """The motion, or the reference chosen for it, does not determine what was asked for."""


class SolverError(CalibrationError):
    """A solver did not reach a minimum; no answer is better than a wrong one."""


class ResultError(CalibrationError):
    """A saved result cannot be read or written."""


class MissingPackageError(CalibrationError):
    """An optional Python package is needed and not installed."""


def require(module: str) -> ModuleType:
    """Import an optional package; raise MissingPackageError, which says how to install it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise missing_package(error) from error


def missing_package(error: ModuleNotFoundError) -> MissingPackageError:
    """Return the named error for an import that found no package."""
    # A module of this package that is missing is a broken installation of it.
    name = str(error.name).partition('.')[0]
    package = _SHARED.get(name, name)
    return MissingPackageError(f'{package} is not installed; pip install {package}')


def in_words(error: Exception) -> str:
    """Return what an error of Python says, without its number and the names of its classes."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    if isinstance(error, KeyError):
        return f'{error.args[0]} is missing' if error.args else 'a key is missing'
    if isinstance(error, UnicodeError):
        return 'it is no text in UTF-8'
    if isinstance(error, RecursionError):
        return 'it is nested too deeply'
    if isinstance(error, AttributeError | LookupError | TypeError):
        return 'a value is of the wrong kind'
    return str(error)


def counted(count: int, noun: str) -> str:
    """Return '1 pose' or '1,200 poses'."""
    return f'{count:,} {noun}' if count == 1 else f'{count:,} {noun}s'


def unknown_name(what: str, name: object, known: Sequence[str], where: str = '') -> str:
    """Return that a name is unknown, and the one that was meant, or else all known ones."""
    near = get_close_matches(str(name), known, n=1)
    return f'{what} {name!r}{where} is unknown; ' + (
        f'did you mean {near[0]}?' if near else f'known are {", ".join(known)}')


def rounded(value: float, digits: int = 2) -> str:
    """Return a number of so many digits, without an exponent where it is large: 0.12, 1,220."""
    return f'{value:,.0f}' if abs(value) >= 10**digits - 0.5 else f'{value:.{digits}g}'


def in_sigmas(ratio: float, digits: int = 0) -> str:
    """Return a number of standard deviations; '> 1000' against those of data without noise."""
    return '> 1000' if ratio > 1000 else f'{ratio:.{digits}f}'

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every error that the package raises on purpose, and helpers for its messages.

A message says in one line what was found, what was needed and what to do next. The command line
prints it unchanged, and the node returns it from a service call.
"""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from types import ModuleType

# Packages inside a namespace package: "pip install ruamel" installs nothing.
_NAMESPACES = {'ruamel': 'ruamel.yaml', 'backports': 'backports.zstd'}


class CalibrationError(Exception):
    """Base class of all errors of this package."""


class ConfigError(CalibrationError, ValueError):
    """A setting is out of its range, misspelt, or contradicts another one."""


class TrajectoryError(CalibrationError, ValueError):
    """Stamps or poses are no trajectory: wrong shape, not finite, not rotations."""


class SourceError(CalibrationError):
    """A file or a bag cannot be read, or has other content than requested."""


class TopicError(SourceError):
    """A bag has no such topic, or the type of the topic holds no poses."""


class AssociationError(CalibrationError):
    """The two trajectories do not overlap in time, or share too few poses."""


class MotionError(CalibrationError):
    """The motion, or the reference chosen for it, does not determine the extrinsic."""


class SolverError(CalibrationError):
    """A solver did not converge to a minimum."""


class ResultError(CalibrationError):
    """A saved result cannot be read or written."""


class MissingPackageError(CalibrationError):
    """An optional Python package is needed but not installed."""


def require(module: str) -> ModuleType:
    """Import an optional package; MissingPackageError says how to install it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise missing_package(error) from error


def missing_package(error: ModuleNotFoundError) -> MissingPackageError:
    """Return the error of this package for a failed import."""
    name = str(error.name).partition('.')[0]
    package = _NAMESPACES.get(name, name)
    return MissingPackageError(f'{package} is not installed; pip install {package}')


def in_words(error: Exception) -> str:
    """Return the message of a Python error without error numbers and class names."""
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
    """Return the message for an unknown name, with the closest known name or all of them."""
    near = get_close_matches(str(name), known, n=1)
    return f'{what} {name!r}{where} is unknown; ' + (
        f'did you mean {near[0]}?' if near else f'known are {", ".join(known)}')


def rounded(value: float, digits: int = 2) -> str:
    """Return a number with ``digits`` significant digits, large ones as integers: 0.12, 1,220."""
    return f'{value:,.0f}' if abs(value) >= 10**digits - 0.5 else f'{value:.{digits}g}'


def in_sigmas(ratio: float, digits: int = 0) -> str:
    """Return a number of standard deviations as text; '> 1000' if the data have no noise."""
    return '> 1000' if ratio > 1000 else f'{ratio:.{digits}f}'

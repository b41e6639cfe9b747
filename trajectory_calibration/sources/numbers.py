# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parse the numbers in the lines of a table; times exactly, without rounding to float."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray

_INT64_MAX = 2**63 - 1
# A date or a time of day, unlike a number, has this: 10:15.
_CLOCK = re.compile(r'\d:\d\d')
# Spellings of a missing number.
_MISSING = {'', 'none', 'null', 'na', 'n/a', 'nat', 'nan(ind)', '-nan(ind)'}


class NotANumberError(ValueError):
    """A field is no number, or a time is out of range: ``args`` are row, column, reason."""


class Numbers(NamedTuple):
    """Some columns of a table.

    Attributes
    ----------
    values : (N, K) numbers of K columns.
    stamps_ns : (N,) times in nanoseconds, 0 if not finite.
    places : (N,) decimals of the times as written, minus the exponent.
    finite, exact : (N,) whether a time is a number, and a whole number of nanoseconds.

    """

    values: FloatArray
    stamps_ns: NDArray[np.int64]
    places: NDArray[np.intp]
    finite: NDArray[np.bool_]
    exact: NDArray[np.bool_]


def read_columns(
    lines: list[str], separator: str | None, width: int, columns: Sequence[int],
    time_column: int | None = None, decimals: int = 0,
) -> Numbers:
    """Return the numbers of some columns, and the exact times of another column.

    Each line has ``width`` fields; the ``separator`` is a comma, or None for white space. The
    unit of the time is 10^-decimals s.

    Raise NotANumberError if a field is no number or a time is out of range; ValueError if a line
    has another number of fields.
    """
    kinds = ['U1'] * width
    for column in columns:
        kinds[column] = 'f8'
    if time_column is not None:
        kinds[time_column] = 'O'
    try:
        table = np.loadtxt(lines, np.dtype([('', kind) for kind in kinds]), comments=None,
                           delimiter=separator, ndmin=1)
    except ValueError:
        known = _without_missing(lines, separator)
        if known != lines:
            return read_columns(known, separator, width, columns, time_column, decimals)
        for row, line in enumerate(lines):
            fields = line.split(separator)
            for column in columns:
                if len(fields) == width and not is_number(fields[column]):
                    raise NotANumberError(row, column, 'is no number') from None
        raise
    values = np.column_stack([np.zeros((len(lines), 0)), *(table[f'f{k}'] for k in columns)])
    words = [] if time_column is None else table[f'f{time_column}'].tolist()
    return with_times(values, words, time_column, decimals)


def with_times(
    values: FloatArray, words: list[str], column: int | None, decimals: int,
) -> Numbers:
    """Return (N, K) values with the times parsed from (N,) words; no times if column is None."""
    if column is None:
        nothing = np.zeros(0, dtype=np.int64)
        return Numbers(values, nothing, nothing, nothing > 0, nothing > 0)
    return Numbers(values, *_times(words, 9 - decimals, column))


def _without_missing(lines: list[str], separator: str | None) -> list[str]:
    """Return the lines with NaN in empty fields and in place of the ``_MISSING`` words."""
    return [(separator or ' ').join(
        'nan' if word.strip().lower() in _MISSING else word for word in line.split(separator))
        for line in lines]


def is_number(word: str) -> bool:
    """Return whether a word is a number; unlike ``float``, without underscores and non-ASCII."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and '_' not in word


def read_dates(words: list[str]) -> NDArray[np.datetime64] | None:
    """Return (N,) dates in UTC, NaT for a missing one; None if a word is no date.

    Dates without a time zone are taken as UTC.
    """
    dates = ['NaT' if word.strip().lower() in {'nan', *_MISSING} else
             re.sub(r'\s*(Z|\+00:?00)$', '', word.strip()) for word in words]
    if not any(map(is_number, dates)):
        with suppress(ValueError):
            return np.array(dates, dtype='datetime64[ns]')
    return None


def _times(words: list[str], exponent: int, column: int) -> tuple[
        NDArray[np.int64], NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (N,) words times 10^exponent, rounded half to even; places, finite, exact.

    The results are those of ``Numbers``.
    """
    finite, exact = np.ones((2, len(words)), dtype=bool)
    # Fast path: usually all times have the same number of digits before and after the point.
    digits = np.array(words).view(np.int32).reshape(len(words), -1) - ord('0')
    point = digits[0] == ord('.') - ord('0')
    whole = digits[:, ~point]
    fraction = len(point) - 1 - int(point.argmax()) if point.any() else 0
    if (np.all(digits[:, point] == digits[0, point]) and ((whole >= 0) & (whole <= 9)).all()
            and 0 <= exponent - fraction <= 19 - whole.shape[1] and point.sum() <= 1):
        powers = 10 ** np.arange(whole.shape[1], dtype=np.uint64)[::-1]
        stamps = whole.astype(np.uint64) @ powers * np.uint64(10 ** (exponent - fraction))
        if stamps.max() <= _INT64_MAX:
            return stamps.astype(np.int64), np.full(len(words), fraction), finite, exact
    if not all(map(is_number, words)) and (dates := read_dates(words)) is not None:
        finite = ~np.isnat(dates)
        return np.where(finite, dates.astype(np.int64), 0), np.zeros(
            len(words), dtype=np.intp), finite, exact
    from decimal import Decimal
    scaled, places = [0] * len(words), np.zeros(len(words), dtype=np.intp)
    for row, word in enumerate(words):
        if not is_number(word):
            raise NotANumberError(row, column, 'is no time: seconds (since 1970), or a whole date'
                                  if _CLOCK.search(word) else 'is no number')
        # The exception means: not finite, or an exponent beyond the range of Decimal.
        finite[row] = False
        with suppress(ArithmeticError, ValueError):
            number = Decimal(word.strip()).scaleb(exponent)
            scaled[row] = round(number)
            exact[row] = number == scaled[row]
            mantissa, _, power = word.lower().partition('e')
            places[row] = len(mantissa.strip().partition('.')[2]) - int(power or 0)
            finite[row] = True
        if abs(scaled[row]) > _INT64_MAX:
            raise NotANumberError(row, column, 'is out of range, the years 1678 to 2262; '
                                  'in which unit are the times? Say --time-unit')
    return np.array(scaled, dtype=np.int64), places, finite, exact

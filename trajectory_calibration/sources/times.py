# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Times in files: detect the unit, repair wrong formats, read a separate file of times.

Times are exact integer nanoseconds.
"""

from __future__ import annotations

from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.data.findings import Finding
from trajectory_calibration.errors import counted, SourceError
from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.sources.layouts import TIME_UNITS
from trajectory_calibration.sources.numbers import read_dates
from trajectory_calibration.sources.text import read_text, Table

# Smallest time since 1970 in each unit; a smaller unit would mean year 3000 and later.
_EPOCHS = (('ns', 1e17), ('us', 1e14), ('ms', 1e11))
# Decimals of a second for nanoseconds, microseconds and milliseconds.
_DECIMALS = (9, 6, 3)

Stamps = NDArray[np.int64]


def time_unit_of(values: FloatArray) -> str:
    """Return the unit of (N,) times since 1970 from their magnitude, 's' if it is not clear."""
    finite = values[np.isfinite(values)]
    size = float(np.median(np.abs(finite))) if len(finite) else 0.0
    return next((unit for unit, least in _EPOCHS if size >= least), 's')


def check_seconds(
    stamps_ns: Stamps, places: NDArray[np.intp],
) -> tuple[Stamps, list[Finding]]:
    """Return (N,) times that were read as seconds, repaired if needed, and findings.

    ``places`` are their decimals, (N,). Some writers print ``sec.nsec`` without leading zeros,
    12.7 for 12.000000007. Then the number of decimals varies, and the times as decimals are not
    monotonic. This is repaired.
    """
    longest = int(places.max(initial=0))
    if longest in _DECIMALS and longest > int(places.min(initial=0)) >= 0:
        tens = 10 ** np.arange(10, dtype=np.int64)
        seconds = stamps_ns // tens[9]
        written = (stamps_ns - seconds * tens[9]) // tens[9 - places]
        repaired = seconds * tens[9] + written * tens[9 - longest]
        if _is_better(repaired, stamps_ns):
            count = int(np.count_nonzero(repaired != stamps_ns))
            return repaired, [Finding(
                'stamps-unpadded',
                f'{count:,} of {counted(len(stamps_ns), "time")} have fractions without leading '
                'zeros (sec.nsec): repaired', {'stamps': count})]
    return stamps_ns, _doubts(stamps_ns, places)


def _is_better(new: Stamps, old: Stamps) -> bool:
    steps_new, steps_old = np.diff(new).astype(float), np.diff(old).astype(float)
    if not len(steps_new) or (steps_new <= 0).any():
        return False
    uneven_new, uneven_old = (
        float(np.mean(np.abs(steps - np.median(steps)))) for steps in (steps_new, steps_old))
    return bool((steps_old <= 0).any()) or uneven_old > 3 * uneven_new


def _doubts(stamps_ns: Stamps, places: NDArray[np.intp]) -> list[Finding]:
    """Return a question if the times, read as seconds, look like frame numbers."""
    steps = np.diff(stamps_ns)
    # No question for few poses, or for seconds since 1970.
    if len(stamps_ns) < 10 or (steps <= 0).any() or stamps_ns[0] < 0 or (
            stamps_ns[-1] > 1e7 * 1e9):
        return []
    # KISS-ICP writes 0.0000, 1.0000, ... if its data set has no times.
    counted_up = stamps_ns[0] in (0, 10**9) and (steps == 10**9).all()
    if not counted_up and (places > 0).any():
        return []
    first = ', '.join(str(int(stamp) // 10**9) for stamp in stamps_ns[:3])
    return [Finding(
        'stamps-are-numbers',
        f'are its times {first}, ... numbers of frames? They were read as seconds; give the times '
        'with --times (one a line)')]


def read_times(path: Path, unit: str | None) -> tuple[Stamps, NDArray[np.bool_]]:
    """Return the (N,) times of a file with one time per line, and which of them are not finite.

    The times are dates as in KITTI, or numbers in the ``unit``; if it is None, in the unit from
    their magnitude. A frame number before the time and fields after it are ignored; blank and
    comment lines are skipped. Raise SourceError if a line has no time.
    """
    lines = [line.strip() for line in read_text(path).split('\n')]
    lines = [line for line in lines if line and not line.startswith(('#', '%'))]
    if lines and re.match(r'\d{4}-\d\d-\d\d[ T]', lines[0]):
        if (dates := read_dates([line[:29] for line in lines])) is None:
            raise SourceError(f'{path} holds dates that cannot be read')
        return dates.astype(np.int64), np.isnat(dates)
    rows = [re.split(r'[,;\s]+', line, maxsplit=2) for line in lines]
    if rows and not re.match(r'[-+.\d]|nan$', rows[0][0]):
        rows = rows[1:]
    # The time may follow a frame number.
    numbered = len(rows) > 1 and rows[0][1:2] != rows[-1][1:2] and all(
        len(row) > 1 and row[0].isdigit() and int(row[0]) - k in (0, 1)
        and re.match(r'\d', row[1]) for k, row in enumerate(rows))
    return _stamps_of([row[numbered] for row in rows], path, unit)


def _stamps_of(
    words: list[str], path: Path, unit: str | None,
) -> tuple[Stamps, NDArray[np.bool_]]:
    """Return (N,) times in nanoseconds, and which of them are not finite."""
    table = Table.parse(path, '\n'.join(words) + '\n')
    numbers = table.read_numbers([], 0, TIME_UNITS[unit or time_unit_of(table.sample()[:, 0])])
    return numbers.stamps_ns, ~numbers.finite


def stamps_in_names(names: list[str], path: Path) -> tuple[Stamps | None, Stamps | None]:
    """Return (N,) times and (N,) frame numbers from image names; at least one is None."""
    stems = [re.sub(r'\.(png|jpe?g|pgm|bmp|tiff?|exr|webp|ppm)$', '', name.rpartition('/')[2],
                    flags=re.IGNORECASE) for name in names]
    words = [(re.findall(r'\d+(?:\.\d+)?', stem) or [''])[-1] for stem in stems]
    if not all(words):
        return None, None
    stamps_ns, _ = _stamps_of(words, path, None)
    if all(word == stem for word, stem in zip(words, stems, strict=True)) and (
            np.abs(stamps_ns) >= 1e8 * 1e9).all():
        return stamps_ns, None
    return None, stamps_ns // 10**9

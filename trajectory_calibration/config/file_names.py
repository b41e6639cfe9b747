# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""File and folder names made from the names of frames, sensors and recordings."""

from __future__ import annotations

from collections.abc import Iterable
import re


def file_name(name: str) -> str:
    """Return a name of letters, digits and ``_ . + -``: no folder, no hidden file."""
    return re.sub(r'^\.', '_', re.sub(r'[^\w.+-]', '_', name.strip('/'))) or '_'


def file_names(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return a unique file name for each name, none of them in ``taken``; duplicates are numbered.

    Names that differ only in case count as equal, as on some file systems.
    """
    used, unique = {name.casefold() for name in taken}, []
    for name in names:
        stem, count = file_name(name), 1
        while (candidate := stem if count == 1 else f'{stem}_{count}').casefold() in used:
            count += 1
        used.add(candidate.casefold())
        unique.append(candidate)
    return unique

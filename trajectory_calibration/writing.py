"""Text into a file, or a named error."""

from __future__ import annotations

from pathlib import Path

from trajectory_calibration.errors import CalibrationError


def write_text(path: Path, text: str, error: type[CalibrationError]) -> None:
    """Write UTF-8 over what is at ``path``; raise ``error`` where it cannot be written."""
    try:
        path.write_text(text, encoding='utf-8')
    except OSError as cause:
        raise error(f'{path} cannot be written: {cause.strerror or cause}') from cause

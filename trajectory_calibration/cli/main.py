"""The console script ``trajectory_calibration``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
import sys

from trajectory_calibration.cli import benchmark, calibrate, inspect, replay, simulate
from trajectory_calibration.cli.options import join_negative_values
from trajectory_calibration.errors import CalibrationError, ConfigError
from trajectory_calibration.version import __version__

# A module of a subcommand offers add_parser(subparsers), which sets ``run`` to a function of the
# parsed arguments that returns the exit status.
_COMMANDS = (benchmark, calibrate, inspect, replay, simulate)

EXIT_DONE = 0
EXIT_NO_ANSWER = 1
EXIT_USAGE = 2
# What a shell reports for a process that SIGINT ended.
EXIT_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments without the program's name; those of the process where omitted.

    Returns
    -------
    int
        The exit status: 0 done, 1 the data cannot give an answer, 2 wrong usage.

    """
    try:
        arguments = _parser().parse_args(
            join_negative_values(sys.argv[1:] if argv is None else argv))
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else EXIT_USAGE
    try:
        status: int = arguments.run(arguments)
        sys.stdout.flush()
    except CalibrationError as error:
        print(f'error: {" ".join(str(error).split())}', file=sys.stderr)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_NO_ANSWER
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader, head for instance, has seen enough. Python flushes standard output once
        # more at exit; give it a place where that succeeds.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='trajectory_calibration',
        description='Find the pose of sensor b in sensor a from their trajectories.')
    parser.add_argument('--version', action='version', version=__version__)
    subparsers = parser.add_subparsers(title='commands', metavar='COMMAND', required=True)
    for command in _COMMANDS:
        command.add_parser(subparsers)
    return parser

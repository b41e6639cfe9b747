# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the command line returns to the shell, and a verdict carries in JSON and diagnostics."""

DONE = 0
# The data cannot give an answer.
NO_ANSWER = 1
USAGE = 2
# Done, but a direction of the answer is unobservable; ``verify``: it cannot tell.
INCOMPLETE = 3
# ``verify``, ``compare``, ``fleet``: the extrinsic no longer holds.
CHANGED = 4
# What a shell reports for a process that SIGINT ended.
INTERRUPTED = 130

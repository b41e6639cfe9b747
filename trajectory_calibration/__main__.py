# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Run the command line: ``python -m trajectory_calibration``."""

import sys

from trajectory_calibration.cli.main import main

if __name__ == '__main__':
    sys.exit(main())

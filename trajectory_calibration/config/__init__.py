# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Every setting, its range, its default and its help text; priors; YAML files."""

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Two clocks become one: offset, drift, interpolation, pairing."""

# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Poses one by one: buffers, readiness, session, store and solver process; no ROS."""

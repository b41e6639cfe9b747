# Copyright 2026 trajectory_calibration maintainers
# SPDX-License-Identifier: Apache-2.0
"""Measurements that stand in docs/; run from a checkout, not installed."""

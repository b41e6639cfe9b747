"""Measurements that stand in docs/; run from a checkout, not installed."""

"""Poses one by one: buffers, readiness, session, store and solver process; no ROS."""

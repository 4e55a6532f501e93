"""Owns how polars is told to write a time as `iso_time` does.

It must not know any format that holds times.
"""

TIME_FORMAT = "%Y-%m-%dT%H:%M:%S%.9fZ"
"""ISO 8601 in UTC with nine digits: `2026-01-31T12:00:00.000000001Z`."""

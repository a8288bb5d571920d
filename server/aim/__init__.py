"""Aim corrections: what a machine misses on average, learned from its throws, applied by a person."""

"""Replays of recorded throws in the twin."""

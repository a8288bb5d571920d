"""Throws: arm and fire, hold, events, logs, history, statistics."""

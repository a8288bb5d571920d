"""Watches whether machines still throw as they did: a sequential test on what their throws miss."""

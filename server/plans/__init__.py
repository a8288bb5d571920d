"""Targets, plans and their previews; policies."""

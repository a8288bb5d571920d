"""Diagnoses of one stage from its own data: actuation, swing, flight."""

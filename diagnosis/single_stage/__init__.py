"""Diagnoses of a single stage from its own record: actuation, swing, flight."""

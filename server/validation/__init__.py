"""Validations of policy versions, their gates, and comparisons of versions."""

"""Validation of a policy version: throws with several machines, and gates for what they must show."""

"""Definitions shared by all packages: spec, kinematics, ballistics, messages, log format.

Depends on numpy and pydantic only.
"""

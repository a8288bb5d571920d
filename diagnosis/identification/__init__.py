"""Identification of a machine from recorded motion: drive response, release delay, free swing."""

"""Faults of the virtual machine; their physics is independent of the twin's effects."""

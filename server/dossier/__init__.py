"""Dossiers: everything about one throw, or a machine's throws of a period, in one signed file."""

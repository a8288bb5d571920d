"""Bulk material: how thrown loads fall and pile up, and where to throw the next ones."""

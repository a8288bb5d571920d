"""Anybody's CSV: layout, columns, units and runs."""

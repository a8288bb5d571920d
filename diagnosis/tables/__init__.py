"""Records from CSV tables: layout, columns, units, runs; joint records, free swings, flights."""

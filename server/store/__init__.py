"""The database, its tables, and machine events on their way into it."""

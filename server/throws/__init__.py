"""Throws: in the making, in the database, in statistics and replays."""

"""`downrange commission`: measure a machine in one go, keep what it did, and say what the twin explains."""

"""What stands around a machine, and where a load in flight meets it."""

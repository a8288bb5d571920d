"""The plant `ring`: rigid arm in C with load-sensing hydraulics and an oil spring in every drive."""

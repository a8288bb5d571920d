"""The command line: one verb a module, each importing only what it needs."""

"""Baselines: what other tools do, run on the same data sets as the diagnosis."""

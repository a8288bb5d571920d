"""Bayesian evidence for sets of effects, and model selection by it."""

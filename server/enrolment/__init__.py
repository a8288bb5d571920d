"""Machines come and go: one-time tokens, the self-test of a new machine, growth of the link's accounts."""

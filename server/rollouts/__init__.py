"""Rollouts of a policy version, stage by stage, each ended by a sequential test on real throws."""

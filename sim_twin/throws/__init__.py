"""Simulated throws: rollouts, previews, campaigns, their logs and their accuracy."""

"""Challenges: data sets with hidden effects, blind runs, scores."""

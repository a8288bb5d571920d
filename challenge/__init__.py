"""Blind challenges: data sets with hidden effects, answers without the truth, scores against it."""

"""Linearisation of a set of throws about a set of effects: residuals, slopes, whitening."""

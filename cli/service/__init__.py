"""Verbs that need the web service: run it, administer it, throw through it."""

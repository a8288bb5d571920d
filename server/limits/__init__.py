"""Limits per caller: connections, streams, failed logins."""

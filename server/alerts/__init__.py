"""Alerts about machines and the server: opened by rules, acknowledged by people, sent to other systems."""

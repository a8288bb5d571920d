"""Commissioning of a machine: valve tables, velocity responses, registration, identification tests."""

"""Machines: link, state, leases, commands, STOP, twin profiles."""

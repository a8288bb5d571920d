"""The web service: accounts, machines, leases, plans, throws, audit, the 3D view."""

"""The 100 Hz control step and everything it is made of; pure but for the core that owns the driver."""

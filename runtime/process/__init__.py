"""The machine's processes: a supervisor, the control loop, the link."""

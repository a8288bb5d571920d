"""The twin: MuJoCo with velocity-response actuation, and one machine's profile of it."""

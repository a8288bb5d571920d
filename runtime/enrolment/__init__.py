"""A machine's computer is set up with a one-time token, and tests itself."""

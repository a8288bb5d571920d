"""Policy versions on machines: what each has on board, and what it is to have."""

"""What a machine's own motion says about it: valve tables, responses, registration."""

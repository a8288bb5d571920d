"""Independent plants: machines written apart from the twin and its diagnosis, to measure both on."""

"""Search for the sets of effects that explain a set of throws, and their ranking."""

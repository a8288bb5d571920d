"""The plant `mule`, written apart from the twin and its diagnosis."""

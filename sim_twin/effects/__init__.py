"""Effects that the twin can be given: the table of all of them, and the physics of each."""

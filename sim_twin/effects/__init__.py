"""Effects that the twin can be given: the library, and the physics of each."""

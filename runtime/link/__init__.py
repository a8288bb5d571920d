"""Both ends' Zenoh configuration, and the machine's end of the link."""

"""What a machine's recorded motion says about it: response, release delay, free swing, with intervals."""

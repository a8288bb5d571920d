"""What one caller may hold open, so that nobody can keep the others, or STOP, away."""

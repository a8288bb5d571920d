"""The batched training environment."""

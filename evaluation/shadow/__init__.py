"""What another policy version would have done in recorded throws."""

"""What the three stages do by themselves: joints over commands, free swings, flights."""

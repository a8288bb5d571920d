"""The report of a diagnosis, and the vocabulary that it shares with the console."""

"""Accuracy of policies over many simulated throws: campaigns, statistics with intervals, and the report."""

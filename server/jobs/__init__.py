"""Bulk jobs: loads are proposed, thrown by people in Operate, and recorded; no machine is commanded."""

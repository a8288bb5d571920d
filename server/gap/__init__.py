"""Diagnoses of machines against their twins, and the twin versions that come of them."""

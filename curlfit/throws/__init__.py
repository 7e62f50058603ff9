"""Throws: measured or simulated paths, and what can be seen in them without a law."""

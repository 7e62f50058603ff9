"""Throws: measured or simulated paths, and their inspection before a fit."""

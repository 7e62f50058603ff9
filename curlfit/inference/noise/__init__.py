"""Noise: its models, how it is made independent, robust losses."""

"""Noise models, whitening of correlated noise, and robust losses."""

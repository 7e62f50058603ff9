"""Sampling of the posterior."""

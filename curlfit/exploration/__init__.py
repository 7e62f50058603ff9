"""Exploration: a fit whose parameters are moved by hand, in a notebook."""

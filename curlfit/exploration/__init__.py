"""Exploration of a fit in a notebook, with its parameters changed by hand."""

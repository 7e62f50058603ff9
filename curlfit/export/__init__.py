"""Saved results in other forms: tables, papers, ArviZ, games."""

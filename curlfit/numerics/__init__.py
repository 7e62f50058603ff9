"""Compiled programs, batches, threads, array types and a least-squares solver."""

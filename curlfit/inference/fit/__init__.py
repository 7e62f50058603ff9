"""Least-squares fits of throws: preparation, rounds, uncertainties and records."""

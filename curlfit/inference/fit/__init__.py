"""Least-squares fits of throws: problems, revisions, uncertainties and records."""

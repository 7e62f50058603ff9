"""Reports: a saved result as one HTML page that needs no network."""

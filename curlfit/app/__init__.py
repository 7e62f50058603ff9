"""A page in the browser on which files are dropped, read, fitted and compared."""

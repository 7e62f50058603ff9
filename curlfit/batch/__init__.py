"""`curlfit batch`: many throws, each by itself, into one table."""

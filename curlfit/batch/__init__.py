"""`curlfit batch`: many throws, each fitted separately, in one table."""

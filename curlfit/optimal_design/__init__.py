"""`curlfit design`: optimal selection of throws."""

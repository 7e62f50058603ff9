"""`curlfit predict`: a fit carried on to rest, or to another throw."""

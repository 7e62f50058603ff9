"""`curlfit predict`: a fit extrapolated to rest, or to another throw."""

"""`curlfit design`: throws that would tell most."""

"""`curlfit compare`: many laws on one throw."""

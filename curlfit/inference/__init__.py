"""From a throw to parameters: likelihood, least squares, identifiability, posterior."""

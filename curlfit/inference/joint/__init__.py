"""The fit of several throws with coefficients in common."""

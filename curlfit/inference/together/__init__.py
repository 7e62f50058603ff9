"""Joint fit of several throws with shared coefficients."""

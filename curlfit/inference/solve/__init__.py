"""Initial values, and the least-squares optimum of one throw, many or all together."""

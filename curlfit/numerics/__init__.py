"""Configuration of JAX, compiled programs, array types and a least-squares solver."""

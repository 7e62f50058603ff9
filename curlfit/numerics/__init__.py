"""JAX and what is computed with it whatever the subject: set-up, compiled programs, a solver."""

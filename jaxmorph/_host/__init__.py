"""NumPy and SciPy in, ids out: nothing here imports JAX or the rest of jaxmorph."""

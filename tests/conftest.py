"""Every test runs in float64; those about float32 ask for it themselves."""

import jax

jax.config.update("jax_enable_x64", True)

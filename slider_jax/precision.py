"""Sets JAX's floating-point precision. Importing slider_jax does not change the precision."""


def enable_float64() -> None:
    """Switches JAX to float64. Call this function before you create any array.

    The beam's equations are stiff, so a time step in float32 cannot reach the solver's tolerance.
    """
    import jax

    jax.config.update("jax_enable_x64", True)

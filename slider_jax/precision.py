"""Floating-point precision. Programs set it; importing the library does not change it."""


def enable_float64() -> None:
    """Switches JAX to float64. Call this function before you create any array.

    The beam is stiff, so a time step in float32 cannot reach its tolerance.
    """
    import jax

    jax.config.update("jax_enable_x64", True)

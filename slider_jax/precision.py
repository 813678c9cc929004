"""Floating-point precision, set by programs and never by the library."""


def enable_float64() -> None:
    """Make JAX compute in float64 from now on. Call it before any array is made.

    The beam is stiff: in float32 a step cannot reach its tolerance. The command line and the tests
    call this; importing `slider_jax` does not.
    """
    import jax

    jax.config.update("jax_enable_x64", True)

"""Predicts sensor readings and their derivatives with respect to the parameters, for a model with
candidate effects. This package may import every package of `slider_jax` except `cli`."""

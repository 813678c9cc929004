"""Predicts the readings of trials and their tangents, for a model with all candidate effects. This
package may import every package of `slider_jax` except `cli`."""

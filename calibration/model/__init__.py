"""The simulator with candidate effects, and its predictions and tangents on measured trials. May
import every room of `slider_jax` except `cli`."""

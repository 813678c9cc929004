"""The planar beam: parameters, grid, state, body frame, and the equations of one cell. This package
may import `errors` and `precision`."""

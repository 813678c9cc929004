"""The planar beam: robot, numerical settings, grid, state, body frame, and the equations of one
cell. It may import `errors` and `precision`."""

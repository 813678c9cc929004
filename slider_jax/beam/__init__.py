"""The planar beam: robot and numerical settings, grid, state, body frame, and the equations of one
cell. May import `errors` and `precision`."""

"""The model and its solution in time: pressures, residual, structured solver, Newton's method,
steps, rollouts and shapes at rest. It may import `effects` and lower layers."""

"""The model and its solution in time: pressures, residual, structured solver, Newton's method,
steps, rollouts and shapes at rest. May import `effects` and the rooms below it."""

"""Solves the model in time: pressures, residual, Newton solver, time steps, rollouts and static
shapes. This package may import `effects` and packages of lower layers."""

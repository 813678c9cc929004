"""A rod at rest in three dimensions: shape, loads, equilibrium and stability. This package may
import `errors`."""

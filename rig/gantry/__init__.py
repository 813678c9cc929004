"""The gantry's motion profile and driver, and the search for the swimming speed.
This package may import `camera`, `force`, `manifold` and packages of lower layers."""

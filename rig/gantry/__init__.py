"""Drives the gantry and searches for the swimming speed: motion profile, driver and search. This
package may import `camera`, `force`, `manifold` and packages of lower layers."""

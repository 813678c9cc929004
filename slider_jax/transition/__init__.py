"""Simulates a robot that swims to a wall, grips it and climbs out of the water. This package may
import `climbing` and packages of lower layers."""

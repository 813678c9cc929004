"""The gantry: its motion profile, its driver, and the search for the swimming speed.

May import `camera`, `force`, `manifold` and the rooms below them.
"""

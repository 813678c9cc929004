"""Optimises tail and gait for one task or two: optimisers, populations, design spaces and reports.
May import `climbing`, `sweep` and the rooms below them."""

"""Drivers of the pneumatic manifold, for our firmware and the published one, and pressure limits.
May import `recording` and `protocol`."""

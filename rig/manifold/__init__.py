"""Drivers of the pneumatic manifold, for this project's firmware and the published one.

May import `recording` and `protocol`.
"""

"""Simulated rig behind real ports and sockets, with faults.

May import `camera`, `force`, `manifold` and the rooms below them.
"""

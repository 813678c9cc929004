"""Simulates the rig behind real ports and sockets, with faults. This package may import `camera`,
`force`, `manifold` and packages of lower layers."""

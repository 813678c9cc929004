"""Simulates climbing in air, pinned to a wall, and reports speed and efficiency. This package may
import `swimming` and packages of lower layers."""

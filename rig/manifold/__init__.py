"""Drivers of the pneumatic manifold, for this project's firmware and the published firmware. This
package may import `recording` and `protocol`."""

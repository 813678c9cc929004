"""Simulates free swimming and computes the steady speed, the performance and reports. This package
may import `batch` and packages of lower layers."""

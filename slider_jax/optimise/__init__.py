"""Optimises tail and gait for swimming, or for swimming and climbing. This package may import
`climbing`, `sweep` and packages of lower layers."""

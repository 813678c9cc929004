"""Predicts the markers of a soft arm with two tendons from the tensions. This package may import
`reporting` and packages of lower layers."""

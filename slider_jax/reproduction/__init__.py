"""Repeats the paper's frequency sweep and design maps, and measures wavelengths. This package may
import `climbing`, `sweep` and packages of lower layers."""

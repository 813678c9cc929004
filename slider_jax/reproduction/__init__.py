"""Reproduces the paper's frequency sweep, performance table and design maps. This package may
import `climbing`, `sweep` and packages of lower layers."""

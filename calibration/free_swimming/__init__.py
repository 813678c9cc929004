"""Compares the paper's published swimming speeds with those of its equations. This package may
import `discrepancy` and packages of lower layers."""

"""Compares the published swimming speeds with speeds from the paper's equations. This package may
import `discrepancy` and packages of lower layers."""

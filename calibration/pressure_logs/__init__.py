"""Reads, audits and fits the rig's pressure logs, and finds missing effects in them. This package
may import `discrepancy` and packages of lower layers."""

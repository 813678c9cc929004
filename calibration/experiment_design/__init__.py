"""Predicts the information of trials and proposes the next trial. This package may import
`discrepancy` and packages of lower layers."""

"""Identifies parameters from measured trials, as constants or as values per drive frequency. This
package may import `experiment_design` and packages of lower layers."""

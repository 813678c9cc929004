"""Identifies the base parameters from measured trials, for all or for each drive frequency. This
package may import `experiment_design` and packages of lower layers."""

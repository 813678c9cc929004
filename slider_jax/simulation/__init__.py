"""Simulates an experiment's trials: readings, summaries, plots, films and signatures of effects.
This package may import `experiment` and packages of lower layers."""

"""Simulates an experiment's trials: sensor readings, summaries, plots, films and the signatures of
effects. May import `experiment` and the rooms below it."""

"""Simulates an experiment's trials: sensor readings, summaries, plots, films, and what an effect
changes in them. May import `experiment` and the rooms below it."""

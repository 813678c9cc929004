"""Reads experiment files and prepares their trials: models, played drives and measured data. May
import `paper`, `channels` and the rooms below them."""

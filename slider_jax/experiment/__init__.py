"""Reads experiment files and prepares trials: models, played drives and measured data. It may
import `paper`, `channels` and lower layers."""

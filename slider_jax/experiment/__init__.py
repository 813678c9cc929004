"""The experiment file: its schema, the models of its trials, and the drive as it was played. May
import `paper`, `channels` and the rooms below them."""

"""Writes and reads recordings: HDF5 files, which remain readable if the writing process is killed.
This package may import `protocol`."""

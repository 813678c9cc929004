"""Writes all readings of a trial to an HDF5 file that survives a killed process, and reads it.
May import `protocol`."""

"""Writes all readings of a trial to HDF5 so that a killed process loses little, and reads them
back. May import `protocol`."""

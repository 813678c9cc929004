"""Writes and reads recordings: HDF5 files that stay readable if the writing process is killed. This
package may import `protocol`."""

"""A rig that is not there: no program can tell it from a port or a socket."""

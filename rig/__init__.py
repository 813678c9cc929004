"""Programs for the lab's tank: pressure commands, sensor readings and recordings.
Except for `cli`, this package needs no JAX, so it runs on a small computer beside the tank."""

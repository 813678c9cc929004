"""Programs for the lab's tank: pressure commands, sensor readings and recordings.

The package needs neither JAX nor the simulator, so it runs on the small computer beside the tank.
"""

"""The lab's side of the tank: commands to the pneumatics, readings of the sensors, recordings.

It needs neither JAX nor the simulator, so that it runs on the small computer beside the tank.
"""

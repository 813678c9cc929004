"""Contains the program `slider` and the commands of the simulator. This package may import all
packages. Only the packages `rig.cli` and `calibration.cli` may import this package."""

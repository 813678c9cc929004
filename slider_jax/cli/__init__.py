"""Contains the program `slider` and the commands of the simulator. This package may import all
packages. Of the other packages, only `rig.cli` and `calibration.cli` import it."""

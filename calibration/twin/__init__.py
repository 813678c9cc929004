"""Runs the calibrated model in parallel with the rig, estimates k and K_Q, and raises alarms. This
package may import `inference`, `audit` and packages of lower layers."""

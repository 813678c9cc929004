"""An experiment for the simulated rig, and a program that handles Ctrl-C."""

HANDLES_CTRL_C = """
import signal, sys
from slider_jax.cli.main import main
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(main(sys.argv[1:]))
"""
"""Restores the handler of SIGINT, which a shell's background jobs ignore."""

EXPERIMENT = """
name = "vents"
[robot]
body_length = 0.298
tail_length = 0.07
linear_density = 0.7
EI_body = 0.038
EI_tail = 0.0058
damping_time = 0.002
height = 0.03
front_chamber = [0.02, 0.145]
rear_chamber = [0.155, 0.28]
[parameters]
C_d = 2.0
m_a = 0.5
k = 0.05
K_Q = 4.79e-7
[[trials]]
file = "a.csv"
frequency = 5.0
amplitude = 200e3
duration = {duration}
"""

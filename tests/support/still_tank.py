"""An experiment in still water with candidate effects and the limits of the next trial."""

from calibration.model.plan import Resolution

EFFECTS = ("regulator_gain", "actuator_saturation", "actuator_quadratic", "carried_mass",
           "surge_compliance", "axial_added_mass", "pressure_gain", "force_gain")  # fmt: skip

MESH = Resolution(13, 40, 6.0e-3)

LIMITS = {"frequency": (2.0, 4.4), "amplitude": (135e3, 275e3), "phase": (0.1, 0.1)}

NOISE = "force_noise = 0.02\nforce_tare = 0.01\nforce_slow_noise = 0.01\npressure_noise = 700.0\n"

STILL = (
    ("sample_rate = 500.0", "sample_rate = 200.0"),
    ("[sensors]\n", f"[sensors]\ntip_noise = 0.0005\n{NOISE}"),
    ("tow_speed = 0.2", "rear_ratio = 0.9\nphase = 0.1\ntow_speed = 0.0"),
)

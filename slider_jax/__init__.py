"""Differentiable simulator of SLIDER, a soft pneumatic lamprey-like robot.

Public names are loaded on first use, so `import slider_jax` is fast and changes no global setting
of JAX. Import all other names from their modules, for example
`from slider_jax.dynamics.rollout import rollout`.
"""

from importlib import import_module

__version__ = "0.1.0"

_HOME = {
    "BACKWARD_EULER": "dynamics.time_schemes",
    "Clamped": "supports",
    "Drive": "dynamics.model",
    "FirstOrderLag": "actuation",
    "Free": "supports",
    "GriddedField": "water",
    "Gravity": "effects",
    "Ideal": "actuation",
    "InputError": "errors",
    "Model": "dynamics.model",
    "NormalDrag": "effects",
    "Numerics": "beam.parameters",
    "PinnedLink": "supports",
    "ReactiveForce": "effects",
    "Recorded": "actuation",
    "Robot": "beam.parameters",
    "uniform_robot": "beam.parameters",
    "SDIRK2": "dynamics.time_schemes",
    "SineWave": "actuation",
    "SolverError": "errors",
    "SquareWave": "actuation",
    "TimeGrid": "dynamics.rollout",
    "Trapezoid": "actuation",
    "VortexStreet": "water",
    "WaterField": "water",
    "enable_float64": "precision",
}

__all__ = sorted(_HOME)


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__():
    return sorted([*globals(), *_HOME])

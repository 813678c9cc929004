"""Nonuniform water: velocity fields of place and time. This package may import `beam`."""

from slider_jax.water.base import WaterField as WaterField
from slider_jax.water.gridded import GriddedField as GriddedField, read_field as read_field
from slider_jax.water.vortex_street import (
    VortexStreet as VortexStreet,
    karman_speed as karman_speed,
)

"""Every effect by name: what a file may add to a model, and what a residual may be traced to."""

from slider_jax.effects.base import Effect
from slider_jax.effects.body.axial_flexibility import AxialFlexibility
from slider_jax.effects.body.body_stiffness import BodyStiffness
from slider_jax.effects.body.carried_mass import CarriedMass
from slider_jax.effects.body.clamp_compliance import ClampCompliance
from slider_jax.effects.body.cubic_elasticity import CubicElasticity
from slider_jax.effects.body.gravity import Gravity
from slider_jax.effects.body.internal_friction import InternalFriction
from slider_jax.effects.body.material_damping import MaterialDamping
from slider_jax.effects.body.pressure_stiffening import PressureStiffening
from slider_jax.effects.body.rest_curvature import RestCurvature
from slider_jax.effects.body.stiffening import Stiffening
from slider_jax.effects.body.stress_relaxation import StressRelaxation
from slider_jax.effects.body.surge_compliance import SurgeCompliance
from slider_jax.effects.body.sway_compliance import SwayCompliance
from slider_jax.effects.body.tail_stiffness import TailStiffness
from slider_jax.effects.body.tip_mass import TipMass
from slider_jax.effects.pneumatics.actuator_cubic import ActuatorCubic
from slider_jax.effects.pneumatics.actuator_hysteresis import ActuatorHysteresis
from slider_jax.effects.pneumatics.actuator_quadratic import ActuatorQuadratic
from slider_jax.effects.pneumatics.actuator_saturation import ActuatorSaturation
from slider_jax.effects.pneumatics.chamber_crosstalk import ChamberCrosstalk
from slider_jax.effects.pneumatics.chamber_expansion import ChamberExpansion
from slider_jax.effects.pneumatics.chamber_mismatch import ChamberMismatch
from slider_jax.effects.pneumatics.choked_flow import ChokedFlow
from slider_jax.effects.pneumatics.fill_vent_asymmetry import FillVentAsymmetry
from slider_jax.effects.pneumatics.firmware_valves import FirmwareValves
from slider_jax.effects.pneumatics.flow_exponent import FlowExponent
from slider_jax.effects.pneumatics.lag_mismatch import LagMismatch
from slider_jax.effects.pneumatics.leakage import Leakage
from slider_jax.effects.pneumatics.line_lag import LineLag
from slider_jax.effects.pneumatics.orifice_flow import OrificeFlow
from slider_jax.effects.pneumatics.pulsed_valves import PulsedValves
from slider_jax.effects.pneumatics.rate_limit import RateLimit
from slider_jax.effects.pneumatics.rear_valve_delay import RearValveDelay
from slider_jax.effects.pneumatics.regulator_gain import RegulatorGain
from slider_jax.effects.pneumatics.regulator_offset import RegulatorOffset
from slider_jax.effects.pneumatics.supply_cap import SupplyCap
from slider_jax.effects.pneumatics.supply_limit import SupplyLimit
from slider_jax.effects.pneumatics.valve_deadband import ValveDeadband
from slider_jax.effects.pneumatics.valve_delay import ValveDelay
from slider_jax.effects.pneumatics.valve_overlap import ValveOverlap
from slider_jax.effects.sensors.camera_delay import CameraDelay
from slider_jax.effects.sensors.camera_scale import CameraScale
from slider_jax.effects.sensors.force_clock_offset import ForceClockOffset
from slider_jax.effects.sensors.force_crosstalk import ForceCrosstalk
from slider_jax.effects.sensors.force_gain import ForceGain
from slider_jax.effects.sensors.force_resonance import ForceResonance
from slider_jax.effects.sensors.force_sensor_lag import ForceSensorLag
from slider_jax.effects.sensors.hose_load import HoseLoad
from slider_jax.effects.sensors.pressure_gain import PressureGain
from slider_jax.effects.sensors.pressure_offset import PressureOffset
from slider_jax.effects.sensors.pressure_ripple import PressureRipple
from slider_jax.effects.sensors.pressure_sensor_lag import PressureSensorLag
from slider_jax.effects.water.axial_added_mass import AxialAddedMass
from slider_jax.effects.water.head_added_mass import HeadAddedMass
from slider_jax.effects.water.head_drag import HeadDrag
from slider_jax.effects.water.keulegan_carpenter_drag import KeuleganCarpenterDrag
from slider_jax.effects.water.linear_drag import LinearDrag
from slider_jax.effects.water.tail_added_mass import TailAddedMass
from slider_jax.effects.water.tail_drag import TailDrag
from slider_jax.effects.water.tangential_friction import TangentialFriction
from slider_jax.effects.water.tank_current import TankCurrent
from slider_jax.effects.water.tank_seiche import TankSeiche
from slider_jax.effects.water.thinned_friction import ThinnedFriction
from slider_jax.effects.water.tow_speed_error import TowSpeedError

LIBRARY: dict[str, type[Effect]] = {
    effect.name(): effect
    for effect in (
        # command, flow, acting pressure
        ValveDelay,
        RegulatorGain,
        RegulatorOffset,
        SupplyLimit,
        SupplyCap,
        RearValveDelay,
        FillVentAsymmetry,
        LagMismatch,
        ChokedFlow,
        RateLimit,
        ValveDeadband,
        ValveOverlap,
        Leakage,
        FlowExponent,
        OrificeFlow,
        FirmwareValves,
        PulsedValves,
        ChamberExpansion,
        LineLag,
        ActuatorSaturation,
        ActuatorQuadratic,
        ActuatorCubic,
        ChamberMismatch,
        ChamberCrosstalk,
        ActuatorHysteresis,
        # body and mounting
        BodyStiffness,
        TailStiffness,
        MaterialDamping,
        CarriedMass,
        AxialFlexibility,
        Stiffening,
        CubicElasticity,
        PressureStiffening,
        StressRelaxation,
        InternalFriction,
        RestCurvature,
        ClampCompliance,
        SwayCompliance,
        SurgeCompliance,
        # water
        Gravity,
        TangentialFriction,
        ThinnedFriction,
        HeadDrag,
        HeadAddedMass,
        LinearDrag,
        TailDrag,
        TailAddedMass,
        AxialAddedMass,
        TipMass,
        KeuleganCarpenterDrag,
        TankCurrent,
        TowSpeedError,
        TankSeiche,
        # instruments
        PressureGain,
        PressureOffset,
        PressureRipple,
        PressureSensorLag,
        ForceGain,
        HoseLoad,
        ForceCrosstalk,
        ForceSensorLag,
        ForceResonance,
        ForceClockOffset,
        CameraDelay,
        CameraScale,
    )
}

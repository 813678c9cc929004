"""Every effect by name: what a file may add to a model, and what a residual may be traced to."""

from slider_jax.effects.actuator_cubic import ActuatorCubic
from slider_jax.effects.actuator_hysteresis import ActuatorHysteresis
from slider_jax.effects.actuator_quadratic import ActuatorQuadratic
from slider_jax.effects.actuator_saturation import ActuatorSaturation
from slider_jax.effects.axial_added_mass import AxialAddedMass
from slider_jax.effects.axial_flexibility import AxialFlexibility
from slider_jax.effects.base import Effect
from slider_jax.effects.body_stiffness import BodyStiffness
from slider_jax.effects.camera_delay import CameraDelay
from slider_jax.effects.camera_scale import CameraScale
from slider_jax.effects.carried_mass import CarriedMass
from slider_jax.effects.chamber_crosstalk import ChamberCrosstalk
from slider_jax.effects.chamber_expansion import ChamberExpansion
from slider_jax.effects.chamber_mismatch import ChamberMismatch
from slider_jax.effects.choked_flow import ChokedFlow
from slider_jax.effects.clamp_compliance import ClampCompliance
from slider_jax.effects.cubic_elasticity import CubicElasticity
from slider_jax.effects.fill_vent_asymmetry import FillVentAsymmetry
from slider_jax.effects.firmware_valves import FirmwareValves
from slider_jax.effects.flow_exponent import FlowExponent
from slider_jax.effects.force_clock_offset import ForceClockOffset
from slider_jax.effects.force_crosstalk import ForceCrosstalk
from slider_jax.effects.force_gain import ForceGain
from slider_jax.effects.force_resonance import ForceResonance
from slider_jax.effects.force_sensor_lag import ForceSensorLag
from slider_jax.effects.gravity import Gravity
from slider_jax.effects.head_added_mass import HeadAddedMass
from slider_jax.effects.head_drag import HeadDrag
from slider_jax.effects.hose_load import HoseLoad
from slider_jax.effects.internal_friction import InternalFriction
from slider_jax.effects.keulegan_carpenter_drag import KeuleganCarpenterDrag
from slider_jax.effects.lag_mismatch import LagMismatch
from slider_jax.effects.leakage import Leakage
from slider_jax.effects.line_lag import LineLag
from slider_jax.effects.linear_drag import LinearDrag
from slider_jax.effects.material_damping import MaterialDamping
from slider_jax.effects.orifice_flow import OrificeFlow
from slider_jax.effects.pressure_gain import PressureGain
from slider_jax.effects.pressure_offset import PressureOffset
from slider_jax.effects.pressure_ripple import PressureRipple
from slider_jax.effects.pressure_sensor_lag import PressureSensorLag
from slider_jax.effects.pressure_stiffening import PressureStiffening
from slider_jax.effects.pulsed_valves import PulsedValves
from slider_jax.effects.rate_limit import RateLimit
from slider_jax.effects.rear_valve_delay import RearValveDelay
from slider_jax.effects.regulator_gain import RegulatorGain
from slider_jax.effects.regulator_offset import RegulatorOffset
from slider_jax.effects.rest_curvature import RestCurvature
from slider_jax.effects.stiffening import Stiffening
from slider_jax.effects.stress_relaxation import StressRelaxation
from slider_jax.effects.supply_cap import SupplyCap
from slider_jax.effects.supply_limit import SupplyLimit
from slider_jax.effects.surge_compliance import SurgeCompliance
from slider_jax.effects.sway_compliance import SwayCompliance
from slider_jax.effects.tail_added_mass import TailAddedMass
from slider_jax.effects.tail_drag import TailDrag
from slider_jax.effects.tail_stiffness import TailStiffness
from slider_jax.effects.tangential_friction import TangentialFriction
from slider_jax.effects.tank_current import TankCurrent
from slider_jax.effects.tank_seiche import TankSeiche
from slider_jax.effects.thinned_friction import ThinnedFriction
from slider_jax.effects.tip_mass import TipMass
from slider_jax.effects.tow_speed_error import TowSpeedError
from slider_jax.effects.valve_deadband import ValveDeadband
from slider_jax.effects.valve_delay import ValveDelay
from slider_jax.effects.valve_overlap import ValveOverlap

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

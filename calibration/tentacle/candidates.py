"""Candidates for a missing effect: each parameter of each effect, in all runs or in one session."""

import re
from collections.abc import Sequence
from dataclasses import fields
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.tentacle.arm import ArmParts
from calibration.tentacle.effects.base import AbstractArmEffect
from calibration.tentacle.effects.base_place import BasePlace
from calibration.tentacle.effects.base_tilt import BaseTilt
from calibration.tentacle.effects.capstan_friction import CapstanFriction
from calibration.tentacle.effects.initial_bend import InitialBend
from calibration.tentacle.effects.marker_mass import MarkerMass
from calibration.tentacle.effects.marker_place import MarkerPlace
from calibration.tentacle.effects.modulus_profile import ModulusProfile
from calibration.tentacle.effects.section_stiffness import SectionStiffness
from calibration.tentacle.effects.strain_stiffening import StrainStiffening
from calibration.tentacle.effects.tendon_place import TendonPlace
from calibration.tentacle.effects.tension_gain import TensionGain
from calibration.tentacle.effects.tension_offset import TensionOffset
from slider_jax.effects.base import Prior

ARM_EFFECTS: tuple[type[AbstractArmEffect], ...] = (
    TensionGain, TensionOffset, CapstanFriction, TendonPlace, ModulusProfile, StrainStiffening,
    SectionStiffness, InitialBend, MarkerMass, BaseTilt, BasePlace, MarkerPlace,
)  # fmt: skip
"""All effects, in the order in which they change the arm."""


class Candidate(NamedTuple):
    """One parameter of one effect, in all runs or in the runs of one session."""

    name: str
    column: int
    """Index of the parameter among the parameters of all effects."""
    session: str
    """Name of the session; empty for all runs."""
    share: float
    """Part of the known runs in this session; 1 for all runs."""
    prior: Prior


def with_effects(parts: ArmParts, values: Float[Array, " parameters"]) -> ArmParts:
    """Returns the arm with the parameters `values` of all effects."""
    begin = 0
    for effect in ARM_EFFECTS:
        end = begin + len(fields(effect))
        parts = effect(*values[begin:end]).on(parts)
        begin = end
    return parts


def candidates_of(sessions: Sequence[str]) -> list[Candidate]:
    """Returns the candidates for runs of these sessions."""
    names = sorted(set(sessions) - {""})
    found, column = [], 0
    for effect in ARM_EFFECTS:
        scopes = ["", *names] if effect.by_session and len(names) > 1 else [""]
        plain = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", effect.__name__).lower()
        for field in fields(effect):
            for scope in scopes:
                name = f"{plain}.{field.name}" + (f" in session {scope}" if scope else "")
                share = list(sessions).count(scope) / len(sessions) if scope else 1.0
                found.append(Candidate(name, column, scope, share, field.metadata["prior"]))
            column += 1
    return found


def effect_values(
    theta: np.ndarray, candidates: Sequence[Candidate], sessions: Sequence[str]
) -> Float[Array, "runs parameters"]:
    """Returns the parameters of all effects in each run; `theta` has a value for each candidate.

    A candidate of one session leaves the runs of other sessions as they are. In a run of an unknown
    session, it has its mean over the known runs.
    """
    values = np.zeros((len(sessions), sum(len(fields(x)) for x in ARM_EFFECTS)))
    known = {x.session for x in candidates} - {""}
    for value, candidate in zip(theta, candidates, strict=True):
        for run, session in enumerate(sessions):
            if candidate.session in ("", session):
                values[run, candidate.column] += value
            elif session not in known:
                values[run, candidate.column] += candidate.share * value
    return jnp.asarray(values)


def strains_act(values: Float[Array, "runs parameters"]) -> bool:
    """Returns whether an effect that depends on the strains acts in a run."""
    columns = [(effect, field) for effect in ARM_EFFECTS for field in fields(effect)]
    return any(
        effect.uses_strains and bool(np.any(column != field.metadata["prior"].null))
        for (effect, field), column in zip(columns, np.asarray(values).T, strict=True)
    )

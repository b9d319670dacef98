"""Effects: physics that a model may have left out, each a term in one place. `EFFECTS` is the catalogue."""

from __future__ import annotations

from .backlash import Backlash
from .body import BaseTilt, ExternalContact, FloatingBase, Payload
from .compliance import BaseFlexibility, JointElasticity, LinkFlexibility
from .coupling import RotorCoupling, WristCoupling
from .drive import CurrentOffset, FilterLag, MotorSaturation, TimeDelay, TorqueConstant
from .effect import Effect
from .friction import (
    AsymmetricFriction,
    FrictionDrift,
    GearEfficiency,
    LoadFriction,
    PositionFriction,
    PreslidingHysteresis,
    Stribeck,
    TemperatureFriction,
    VacuumFriction,
)
from .position import EncoderEccentricity, EncoderZero, HarnessSpring, TorqueRipple

EFFECTS: dict[str, type[Effect]] = {
    effect.kind: effect
    for effect in (
        Payload,
        FrictionDrift,
        TemperatureFriction,
        LoadFriction,
        GearEfficiency,
        PreslidingHysteresis,
        PositionFriction,
        AsymmetricFriction,
        Stribeck,
        VacuumFriction,
        TorqueRipple,
        JointElasticity,
        Backlash,
        HarnessSpring,
        RotorCoupling,
        WristCoupling,
        BaseTilt,
        FloatingBase,
        LinkFlexibility,
        BaseFlexibility,
        ExternalContact,
        TorqueConstant,
        MotorSaturation,
        CurrentOffset,
        EncoderEccentricity,
        EncoderZero,
        TimeDelay,
        FilterLag,
    )
}

__all__ = ["EFFECTS", "Effect"]

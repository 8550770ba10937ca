"""Devices of a rig behind three small roles, one module per protocol. The one home of pyserial."""

from lightopt.hardware._roles import Camera, Frame, Identity, LightController, Stage, StageState

__all__ = ["Camera", "Frame", "Identity", "LightController", "Stage", "StageState"]

"""Servo models as data: `load_model("AX-18A")`."""

from drivers.servo_models.catalogue import MODELS, load_model, model_by_number
from drivers.servo_models.model import IndirectBlock, ServoModel
from drivers.servo_models.register import Register, Unit

__all__ = ["MODELS", "IndirectBlock", "Register", "ServoModel", "Unit", "load_model", "model_by_number"]

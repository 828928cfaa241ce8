"""Servo models as data: `load_model("AX-18A")`."""

from drivers.servo_models.model import MODELS, Register, ServoModel, load_model, model_by_number

__all__ = ["MODELS", "Register", "ServoModel", "load_model", "model_by_number"]

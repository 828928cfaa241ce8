"""Servo bus and cameras, real and emulated, behind the same small protocols."""

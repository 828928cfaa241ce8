"""Calibration: arrays in, records out."""

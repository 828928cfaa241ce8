"""The calibration package's error: values or views from which no trustworthy calibration follows."""


class CalibrationError(Exception):
    """Root of the errors of calibration; the message says what, where, have, want and next."""

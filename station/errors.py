"""The station's error tree: every failure that a user can cause or mend is a StationError."""


class StationError(Exception):
    """Root of the errors that the command line prints; the message says what, where, have, want and next."""


class InvalidData(StationError):
    """Values that can't be what they are said to be: a pose that is no rigid motion, times that fall, wrong shapes."""


class InvalidFile(StationError):
    """A file that is missing, torn, of another schema, or has unknown keys."""


class LimitExceeded(StationError):
    """A motion that leaves the limits of a joint's angle or speed."""


class NotEnoughMotion(StationError):
    """Data in which a joint moved too little to be identified."""


class OutputExists(StationError):
    """An output folder that exists and isn't empty."""

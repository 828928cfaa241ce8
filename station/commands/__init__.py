"""What the command line does, as functions of the commands' names, a module for each group of them.

Each takes paths and options, returns values, and raises StationError, CalibrationError or DriverError; printing is left
to the caller. rerun, OpenCV and matplotlib are imported where they are used: they take a second.
"""

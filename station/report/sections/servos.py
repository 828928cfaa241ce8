"""Temperatures, voltages and loads of the servos over time."""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray
from station.report.blocks import Drawing, Section, Table, Text
from station.report.drawings import svg
from station.report.material import Material, Servos
from station.report.servo_figure import servo_figure

HEAD = ("servo", "first [°C]", "hottest [°C]", "least [V]", "most [V]", "greatest load [%]", "readings")
ALT = "Temperature, voltage and load of each servo over time"
LOAD = "Load: as the servo estimates it from its current or its drive, as a share of the most that its model has."


def servos_section(material: Material) -> Section | None:
    """None where the recording has no servos' states."""
    servos = material.servos
    if servos is None or not servos.names or not np.any(np.isfinite(servos.temperature_c)):
        return None
    rows = [_row(servos, column) for column in range(len(servos.names))]
    drawing = Drawing("servos", svg(servo_figure(servos)), ALT)
    return Section("servos", "Servos", "The servos", [Table("servos", HEAD, rows), drawing, Text(LOAD, soft=True)])


def _row(servos: Servos, column: int) -> list[str]:
    celsius, volts, load = (_known(v[:, column]) for v in (servos.temperature_c, servos.voltage_v, servos.load))
    return [
        servos.names[column],
        f"{celsius[0]:.0f}" if len(celsius) else "",
        f"{celsius.max():.0f}" if len(celsius) else "",
        f"{volts.min():.1f}" if len(volts) else "",
        f"{volts.max():.1f}" if len(volts) else "",
        f"{100 * np.abs(load).max():.0f}" if len(load) else "",
        str(len(celsius)),
    ]


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]

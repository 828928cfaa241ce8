"""How an emulated servo protects itself: voltage, heat, overload, and the bus watchdog."""

from __future__ import annotations

from drivers.emulator.table import Table

OVERLOAD_NS = 1_000_000_000  # a guess: how long full output lasts until it is an overload; the manuals don't tell
WATCHDOG_NS = 20_000_000  # X-series manual, Bus Watchdog (98): a unit
NEVER_NS = 1 << 62
_VOLT_ROUNDING = 1e-9


class Protection:
    """The alarms of a servo and when they come.

    Attributes:
        alarm: bits of the model's error_bits.
        heard_ns: when the last instruction packet was on the wire.
    """

    def __init__(self, table: Table, heard_ns: int) -> None:
        self._table, self.heard_ns = table, heard_ns
        self.alarm = 0
        self._caused = 0  # bits of `alarm` that a cause set, which may go
        self._saturated_ns: int | None = None
        self._bits = {name: 1 << bit for bit, name in table.model.error_bits.items()}

    @property
    def shut_down(self) -> bool:
        """Whether an alarm is on after which the servo gives no torque."""
        return bool(self.alarm & self._table.get("shutdown"))

    def bits(self, name: str) -> int:
        """The bit of an alarm."""
        return self._bits[name]

    def clear(self) -> None:
        """Forget all alarms; those whose cause is still there come again."""
        self.alarm = self._caused = 0
        self._saturated_ns = None

    def check(self, t_ns: int, *, voltage_v: float, temperature_c: float, saturated: bool) -> int:
        """The alarms that come at a time, as bits. Those of the AX and MX go with their cause (unverified)."""
        causes = self._causes(voltage_v, temperature_c)
        if self._table.model.recovery == "torque_limit":
            gone = self._caused & ~causes
            self.alarm &= ~gone
            self._caused &= ~gone
        new = causes & ~self.alarm
        self._caused |= new
        if not saturated:
            self._saturated_ns = None
        elif self._saturated_ns is None:
            self._saturated_ns = t_ns
        elif t_ns - self._saturated_ns >= OVERLOAD_NS:
            new |= self._bits["overload"] & ~self.alarm
        return new

    def overload_ns(self) -> int:
        """When it is an overload, if the motor goes on giving all that it has."""
        if self._saturated_ns is None or self.alarm & self._bits["overload"]:
            return NEVER_NS
        return self._saturated_ns + OVERLOAD_NS

    def raise_bits(self, bits: int) -> bool:
        """Set alarms; whether Shutdown says that torque goes for them."""
        self.alarm |= bits
        if self._table.model.hardware_error_register is not None:
            self._table.set(self._table.model.hardware_error_register, self.alarm)
        shutdown = bool(bits & self._table.get("shutdown"))
        if shutdown:
            # X: torque is off until a reboot. AX: Torque Limit becomes 0 until it is written (e-manual, Shutdown).
            self._table.set("torque_limit" if self._table.model.recovery == "torque_limit" else "torque_enable", 0)
        return shutdown

    def watchdog_ns(self) -> int:
        """When the bus watchdog strikes if nothing is heard until then; only while torque is on."""
        if "bus_watchdog" not in self._table or not self._table.get("torque_enable"):
            return NEVER_NS
        units = self._table.get("bus_watchdog")
        # "larger than the set value" (manual): one more nanosecond
        return self.heard_ns + units * WATCHDOG_NS + 1 if units > 0 else NEVER_NS

    def _causes(self, voltage_v: float, temperature_c: float) -> int:
        low, high = (self._voltage_limit(name) for name in ("min_voltage_limit", "max_voltage_limit"))
        voltage_ok = low - _VOLT_ROUNDING <= voltage_v <= high + _VOLT_ROUNDING
        causes = 0 if voltage_ok else self._bits["input_voltage"]
        if temperature_c > self._table.get("temperature_limit"):
            causes |= self._bits["overheating"]
        return causes

    def _voltage_limit(self, name: str) -> float:
        return self._table.registers[name].physical(self._table.get(name))

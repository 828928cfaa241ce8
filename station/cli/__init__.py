"""The command line: one subcommand, one function; the only place that prints and exits."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import FrameType
from typing import NoReturn

from station.cli.app import app, calibrate

# Their commands join the application as they are imported: in this order `station --help` lists them.
for _name in (
    "captures",
    "sessions",
    "plan",
    "logs",
    "simulations",
    "sweep",
    "building",
    "boards",
    "camera",
    "arm_calibration",
    "bus",
):
    import_module(f"station.cli.{_name}")
app.add_typer(calibrate)

EXIT_ERROR, EXIT_HARDWARE, EXIT_SIGINT, EXIT_SIGTERM = 1, 3, 130, 143
MAX_ERROR_LINES = 5


def _fail(error: Exception, code: int) -> NoReturn:
    lines = [line for line in str(error).splitlines() if line.strip()][:MAX_ERROR_LINES]
    print("error: " + "\n".join(lines), file=sys.stderr)
    raise SystemExit(code)


def _on_sigterm(signum: int, frame: FrameType | None) -> None:
    raise SystemExit(EXIT_SIGTERM)


def main() -> None:
    """Run the command line: exit code 0 done, 1 a clear error, 2 usage, 3 hardware fault, 130 and 143 after signals."""
    signal.signal(signal.SIGTERM, _on_sigterm)
    debug = "--debug" in sys.argv[1:]
    sys.argv = [argument for argument in sys.argv if argument != "--debug"]
    _guarded(partial(app, prog_name="station"), debug)


def _guarded(command: Callable[[], object], debug: bool) -> None:
    from calibration.errors import CalibrationError
    from drivers.errors import DriverError, NoCamera, NoPort
    from station.errors import StationError

    try:
        command()
    except (StationError, CalibrationError, NoPort, NoCamera) as error:
        if debug:
            raise
        _fail(error, EXIT_ERROR)
    except DriverError as error:
        if debug:
            raise
        _fail(error, EXIT_HARDWARE)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(EXIT_SIGINT) from None

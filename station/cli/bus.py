"""The servo bus: what is on it, whether a rig is fit for use, and an emulated one for other programs."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import Json, RigArgument, Seed, Simulate
from station.cli.show import progress, say_next, table, warn

FAULTS_HELP = "What goes wrong when, such as mute:3@2+1; may be repeated. docs/emulator.md lists them."

if TYPE_CHECKING:
    from drivers.probe import Setting
    from drivers.scan import Found
    from station.doctor.expectation import Match


@app.command()
def scan(
    port: Annotated[
        str | None, typer.Argument(metavar="PORT", help="Serial port; the rig's if left out.", show_default=False)
    ] = None,
    baud: Annotated[
        list[int] | None, typer.Option("--baud", help="Baud to try; may be repeated. All that known models have.")
    ] = None,
    protocol: Annotated[
        list[float] | None, typer.Option("--protocol", help="1.0 or 2.0; both if left out.", show_default=False)
    ] = None,
    ids: Annotated[
        str | None, typer.Option("--ids", help="Ids to ask for, such as 1-20,30; all if left out.", show_default=False)
    ] = None,
    rig: Annotated[
        str | None, typer.Option("--rig", help="Rig whose servos are expected: a file or a packaged one's name.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find the servos on a port, whatever their baud, protocol and id.

    Nothing is written to a servo. Exit code 1 if nothing is found, or a servo isn't there as the rig says.
    """
    from station.doctor.expectation import expected_servos, match_found
    from station.doctor.scanning import choose_settings, open_wire, parse_ids
    from station.errors import StationError
    from station.rig_reading import read_rig

    if any(version not in (1.0, 2.0) for version in protocol or []):
        raise StationError(f"protocol {protocol}: want 1.0 or 2.0")
    rig_table = None if rig is None else read_rig(rig)[0]
    expected = () if rig_table is None else expected_servos(rig_table)
    settings, chosen = choose_settings(baud or [], protocol or [], rig_table), parse_ids(ids)
    found: list[Found] = []
    with open_wire(port, rig_table) as (path, latency_s):
        try:
            _scan_into(found, path, settings, chosen, [want.servo_id for want in expected], latency_s)
        except KeyboardInterrupt:
            _show_scan(path, match_found(expected, found), rig is not None, as_json, narrowed=True)
            raise
    matches = match_found(expected, found)
    narrowed = any(option is not None for option in (baud, protocol, ids))
    _show_scan(path, matches, rig is not None, as_json, narrowed=narrowed)
    if not found or any(match.verdict not in ("as expected", "unexpected") for match in matches):
        raise typer.Exit(1)


def _scan_into(
    found: list[Found],
    path: str,
    settings: Sequence[Setting],
    ids: Sequence[int],
    expected: Sequence[int],
    latency_s: float,
) -> None:
    """Scan with a bar; what is found is kept even if the scan is stopped."""
    from contextlib import closing

    from drivers.scan import Skipped, Step, scan

    with progress() as bar, closing(scan(path, settings, ids, expected=expected, latency_s=latency_s)) as events:
        bar.stage("scan")
        for event in events:
            if isinstance(event, Step):
                bar.update(event.done_s, event.total_s)
                bar.rename(f"{event.setting.baud} baud, {event.setting.protocol:.1f}: {len(found)} found")
            elif isinstance(event, Skipped):
                warn(f"{event.why}; not scanned")
            else:
                found.append(event)


def _show_scan(path: str, matches: Sequence[Match], with_rig: bool, as_json: bool, *, narrowed: bool) -> None:
    from station.doctor.scanning import explain, match_document, match_rows

    count = sum(match.found is not None for match in matches)
    hints = explain(matches, narrowed=narrowed)
    if as_json:
        print(json.dumps({"port": path, "servos": [match_document(match) for match in matches], "hints": hints}))
        return
    if matches:
        table(f"{path}: {count} servo{'' if count == 1 else 's'} found", match_rows(matches, with_rig=with_rig))
    else:
        print(f"{path}: no servo answers")
    if hints:
        say_next("to check:", *(f"- {line}" for line in hints))


@app.command()
def doctor(
    rig: RigArgument,
    fix: Annotated[
        list[str] | None,
        typer.Option(
            "--fix", help="Mend in the servos: return-delay, status-level, drive-mode, operating-mode; may be repeated."
        ),
    ] = None,
    simulate: Simulate = False,
    as_json: Json = False,
) -> None:
    """Check a rig: port, servos, camera, calibration, disk.

    Nothing moves, and nothing is written but what --fix names. Exit code 1 if anything blocks a capture.
    """
    from station.doctor.checkup import examine
    from station.doctor.finding import Verdict, mends, summary_rows

    with progress() as bar:
        checkup = examine(rig, simulate=simulate, fixes=fix or [], say=bar.stage)
    if as_json:
        print(json.dumps(checkup.as_dict(), allow_nan=False))
    else:
        verdicts = [finding.verdict for finding in checkup.findings]
        blocking, doubtful = verdicts.count(Verdict.BLOCKS), verdicts.count(Verdict.WARNING)
        said = f"{blocking or 'nothing'} {'block' if blocking > 1 else 'blocks'} a capture"
        table(f"{rig}: {said}, {doubtful} warnings", summary_rows(checkup.findings))
        for change in checkup.changes:
            print(f"{'mended' if change.done else 'NOT mended'}  {change.where}: {change.said}")
        if lines := mends(checkup.findings):
            say_next("to mend:", *("- " + line.replace("\n", "\n  ") for line in lines))
    if not checkup.passed:
        raise typer.Exit(1)


@app.command()
def emulate(
    rig: RigArgument,
    faults: Annotated[list[str] | None, typer.Option("--faults", metavar="SPEC", help=FAULTS_HELP)] = None,
    link: Annotated[
        Path | None, typer.Option("--link", help="Path of the device; must be free.", show_default=False)
    ] = None,
    seed: Seed = None,
) -> None:
    """Put a rig's servos on a pseudo-terminal, for any other program.

    The first line of standard output is the device's path. Runs until it is stopped with Ctrl-C or SIGTERM.
    """
    from station.emulation import emulate as open_emulation

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    specs = [spec for group in faults or [] for spec in group.split()]
    with open_emulation(rig, faults=specs, link=link, seed=seed) as arm:
        print(arm.path, flush=True)
        say_next(f"{rig}: {arm.summary()}; stop it with Ctrl-C")
        arm.wait()

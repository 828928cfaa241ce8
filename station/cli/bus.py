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
    from station.doctor.expectation import Match


@app.command()
def scan(
    port: Annotated[
        str | None, typer.Argument(metavar="PORT", help="Serial port; the rig's if left out.", show_default=False)
    ] = None,
    baud: Annotated[
        list[int] | None,
        typer.Option("--baud", min=1, help="Baud to try; may be repeated; all known ones."),
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
    from drivers.scan import Event, Found, Skipped, Step
    from station.commands import bus

    count = 0
    with progress() as bar:
        bar.stage("scan")

        def on_event(event: Event) -> None:
            nonlocal count
            if isinstance(event, Step):
                bar.update(event.done_s, event.total_s)
                bar.rename(f"{event.setting.baud} baud, {event.setting.protocol:.1f}: {count} found")
            elif isinstance(event, Skipped):
                warn(f"{event.why}; not scanned")
            elif isinstance(event, Found):
                count += 1

        done = bus.scan(port, bauds=baud or [], protocols=protocol or [], ids=ids, rig=rig, on_event=on_event)
    _show_scan(done.path, done.matches, rig is not None, as_json, narrowed=done.narrowed)
    if not done.complete:
        raise KeyboardInterrupt
    if not count or any(match.verdict not in ("as expected", "unexpected") for match in done.matches):
        raise typer.Exit(1)


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
    from station.commands import bus
    from station.doctor.finding import Verdict, mends, summary_rows

    with progress() as bar:
        checkup = bus.doctor(rig, simulate=simulate, fixes=fix or [], say=bar.stage)
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
    from station.commands import bus

    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    specs = [spec for group in faults or [] for spec in group.split()]
    with bus.emulate(rig, faults=specs, link=link, seed=seed) as arm:
        print(arm.path, flush=True)
        say_next(f"{rig}: {arm.summary()}; stop it with Ctrl-C")
        arm.wait()

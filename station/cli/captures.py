"""What drives an arm or watches one: demo, run, capture."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from station.cli.app import app
from station.cli.options import (
    DryRun,
    DurationS,
    Force,
    Frames,
    FramesKept,
    Hand,
    Headless,
    Json,
    KnownTree,
    MotionArgument,
    MotionOrNone,
    Out,
    OutOrNone,
    Port,
    Realtime,
    Resume,
    RigArgument,
    RigOrNone,
    Seed,
    Simulate,
    UntilEnough,
    View,
    Yes,
)
from station.cli.show import asking, progress, say_next, show_comparison

if TYPE_CHECKING:
    from station.capture.counts import CaptureCounts
    from station.commands.live import LiveServer
    from station.releasing import Ask


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Session folder; must be new or empty.")] = Path("demo"),
    seed: Seed = None,
    realtime: Realtime = False,
    view: View = False,
    headless: Headless = False,
    port: Port = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run the whole station without hardware, to Figure 7.

    Captures the packaged demo motion on an emulated arm and a rendered camera, fits the recording, and compares the
    detected joint angles with the commands and the read-back.
    """
    with live_view(view=view, headless=headless, port=port) as live:
        _run("demo", "demo", out, as_json, live, seed=seed, realtime=realtime, force=force)


@app.command()
def run(
    rig: RigArgument,
    motion: MotionArgument,
    out: Out,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    until_enough: UntilEnough = 0,
    frames: FramesKept = None,
    tree: KnownTree = None,
    view: View = False,
    headless: Headless = False,
    port: Port = None,
    dry_run: DryRun = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Capture, fit, compare and report in one go."""
    if dry_run:
        _show_dry_run(rig, motion, out, simulate=simulate, force=force, as_json=as_json, **_kept(frames))
        return
    with live_view(view=view, headless=headless, port=port) as live:
        made = {"seed": seed, "simulate": simulate, "realtime": realtime, "force": force}
        _run(rig, motion, out, as_json, live, **made, until_enough=until_enough, tree=tree, **_kept(frames))


def _run(rig: str, motion: str, out: Path, as_json: bool, live: LiveServer | None, **settings: Any) -> None:
    from station.cli.attending import attended
    from station.commands import capturing, sessions

    with attended(out, live, fits=True) as attendant:
        capturing.capture(rig, motion, out, live=live, **attendant.settings(), **settings)
    with progress() as bar:
        comparison = sessions.conclude(out, stage=bar.stage)
    show_comparison(comparison, as_json)
    say_next(
        f"Figure 7      {out / 'report' / 'figure7.png'}",
        f"report        {out / 'report' / 'report.html'}",
        f"tree          {out / 'fit' / 'kinematics.json'}",
        f"recording     station view {out}",
    )


@app.command()
def capture(
    rig: RigOrNone = None,
    motion: MotionOrNone = None,
    out: OutOrNone = None,
    hand: Hand = False,
    duration_s: DurationS = None,
    resume: Resume = None,
    yes: Yes = False,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    until_enough: UntilEnough = 0,
    frames: FramesKept = None,
    tree: KnownTree = None,
    view: View = False,
    headless: Headless = False,
    port: Port = None,
    dry_run: DryRun = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run a motion on a rig and record it into a session folder; with --hand, record what people move.

    Ctrl-C holds the arm at once and asks whether to go on; pressed again, or where nobody can be asked, it ends the
    capture and leaves the arm as the rig declares. What was recorded is kept; --resume goes on with it.

    With --hand torque goes off and stays off: an arm that was held DROPS, and you are asked before. The rig needs no
    servos then. Ctrl-C is the normal end.
    """
    made: dict[str, Any] = {"seed": seed, "simulate": simulate, "force": force, **_kept(frames)}
    described = any((rig, motion, out, hand)) or any(made.values()) or seed is not None
    if resume is None and (rig is None or out is None):
        raise typer.BadParameter("want RIG and --out, or --resume SESSION")
    if resume is not None and described:
        raise typer.BadParameter(
            "--resume takes rig, motion, folder, seed and frames from the session: want none beside it"
        )
    if resume is None and hand == (motion is not None):
        raise typer.BadParameter("want a motion, or --hand" if not hand else "want a motion or --hand, not both")
    _check_goes_with(motion, hand=hand, duration_s=duration_s, until_enough=until_enough, dry_run=dry_run)
    folder = Path(str(out))
    if dry_run:
        _show_dry_run(str(rig), str(motion), folder, simulate=simulate, force=force, as_json=as_json, **_kept(frames))
        return
    with live_view(view=view, headless=headless, port=port) as live:
        settings = {"live": live, "realtime": realtime, "until_enough": until_enough, "tree": tree}
        if resume is not None:
            counts = _resume(resume, settings)
        else:
            counts = _capture(str(rig), motion, folder, asking(yes), duration_s, made | settings)
    _show_counts(counts, as_json)


def _check_goes_with(
    motion: str | None, *, hand: bool, duration_s: float | None, until_enough: int, dry_run: bool
) -> None:
    """Raise typer.BadParameter for options that mean nothing with a motion, or with none."""
    if duration_s is not None and not hand:
        raise typer.BadParameter("--duration-s goes with --hand; a motion lasts as long as it does")
    if hand and until_enough:
        raise typer.BadParameter("--until-enough goes with a motion: with --hand people see to it")
    if dry_run and motion is None:
        raise typer.BadParameter("--dry-run goes with RIG and MOTION: what a hand will do nobody knows")


def _capture(
    rig: str, motion: str | None, out: Path, ask: Ask, duration_s: float | None, settings: dict[str, Any]
) -> CaptureCounts:
    """Capture a motion, or by hand without one."""
    from station.cli.attending import attended
    from station.commands import capturing

    with attended(out, settings["live"], by_hand=motion is None) as attendant:
        settings |= attendant.settings()
        if motion is None:
            return capturing.capture_by_hand(rig, out, ask=ask, duration_s=duration_s, **settings)
        return capturing.capture(rig, motion, out, **settings)


def _resume(session: Path, settings: dict[str, Any]) -> CaptureCounts:
    from station.cli.attending import attended
    from station.commands import capturing

    with attended(session, settings["live"]) as attendant:
        return capturing.resume(session, **settings, **attendant.settings())


def _kept(frames: Frames | None) -> dict[str, str]:
    """The setting of how images are kept, where it is given."""
    return {} if frames is None else {"frames": frames.value}


def _show_counts(counts: CaptureCounts, as_json: bool) -> None:
    """What was recorded, and what else was counted if it happened at all."""
    if as_json:
        print(json.dumps(counts.as_dict()))
        return
    always = ("frames", "dropped_frames", "commands", "readings", "bus_errors")
    for name, number in counts.as_dict().items():
        if number or name in always:
            print(f"{name.replace('_', ' '):22} {number}")


def _show_dry_run(rig: str, motion: str, out: Path, **settings: Any) -> None:
    from station.cli.plan import show_dry_run

    show_dry_run(rig, motion, out, **settings)


@contextmanager
def live_view(*, view: bool, headless: bool, port: int | None) -> Iterator[LiveServer | None]:
    """The live view that the options ask for; None without one. Raises typer.BadParameter where they disagree."""
    if view and headless:
        raise typer.BadParameter("want --view or --headless, not both: a viewer that is opened is served, too")
    if not view and not headless:
        if port is not None:
            raise typer.BadParameter("--port goes with --view or --headless")
        yield None
        return
    from station.commands.live import live_server

    with live_server(port, opens=view) as server:
        say_next(f"live view     rerun {server.address}")
        yield server

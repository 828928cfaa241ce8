"""What a motion will do, and what the camera will see of it, before anything moves: plan, and --dry-run of others."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import Force, Json, MotionArgument, RigArgument, Simulate
from station.cli.show import say_next, table, warn

if TYPE_CHECKING:
    from station.commands.foreseeing import Outlook


@app.command()
def plan(
    rig: RigArgument,
    motion: MotionArgument,
    tree: Annotated[
        Path | None,
        typer.Option(
            "--tree", metavar="SESSION", help="A fitted session that tells what is where, not the rig's drawing."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the picture; must be new or empty.", show_default=False)
    ] = None,
    simulate: Simulate = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Check a whole motion against a rig's limits, and foresee what the camera will see; nothing moves.

    Prints what will be commanded when, which markers will be seen how obliquely and how smeared, and of which joints
    the angle will be seen. With --out it draws plan.png and plan.svg.
    """
    from station.commands import foreseeing
    from station.session import check_output_folder

    if out is not None:
        check_output_folder(out, force=force)
    outlook = foreseeing.foresee_motion(rig, motion, tree=tree, simulate=simulate, folder=out)
    pictures = () if out is None else foreseeing.save_picture(outlook, out / foreseeing.PICTURE)
    _show(outlook, rig, pictures, as_json)


def show_dry_run(
    rig: str, motion: str, out: Path, *, simulate: bool, force: bool, as_json: bool, frames: str = "jpeg"
) -> None:
    """What a capture would do: the same checks, and the picture beside the session's folder, which stays free."""
    from station.commands import foreseeing
    from station.session import check_output_folder

    check_output_folder(out, force=force)
    outlook = foreseeing.foresee_motion(rig, motion, simulate=simulate, folder=out, frames=frames)
    _show(outlook, rig, foreseeing.save_picture(outlook, out.with_name(f"{out.name}_plan")), as_json)


def _show(outlook: Outlook, rig: str, pictures: tuple[Path, ...], as_json: bool) -> None:
    from station.commands import foreseeing, planning

    planned = outlook.plan
    if as_json:
        document = planning.plan_document(planned) | foreseeing.outlook_document(outlook)
        print(json.dumps(document, allow_nan=False))
        return
    title = f"motion '{planned.motion.name}' on {rig}: {planned.duration_s:.1f} s, within all limits"
    table(title, planning.plan_rows(planned))
    if outlook.forecast is not None:
        exposure_ms = 1e3 * outlook.forecast.scene.exposure_s
        table(f"What the camera will see, {exposure_ms:.3g} ms open", foreseeing.marker_rows(outlook.forecast))
        table("Joints: a marker seen on either side", foreseeing.joint_rows(outlook))
    for note in (*planned.motion.notes, *outlook.notes):
        say_next(f"note: {note}")
    for warning in outlook.warnings:
        warn(warning)
    if pictures:
        say_next(f"picture       {pictures[0]}")

"""What a motion will do, before anything moves: plan."""

from __future__ import annotations

import json

from station.cli.app import app
from station.cli.options import Json, MotionArgument, RigArgument
from station.cli.show import table


@app.command()
def plan(rig: RigArgument, motion: MotionArgument, as_json: Json = False) -> None:
    """Check a whole motion against a rig's limits; nothing moves.

    Prints what will be commanded when.
    """
    from station.commands import planning

    planned = planning.plan(rig, motion)
    rows = planning.plan_rows(planned)
    if as_json:
        print(json.dumps(planning.plan_document(planned), allow_nan=False))
        return
    table(f"motion '{planned.motion.name}' on {rig}: {planned.duration_s:.1f} s, within all limits", rows)

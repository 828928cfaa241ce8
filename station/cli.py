"""The command line: one subcommand, one function; the only place that prints and exits."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from station.compare import Comparison
    from station.kinematics.tree import KinematicTree

EXIT_ERROR, EXIT_HARDWARE, EXIT_SIGINT, EXIT_SIGTERM = 1, 3, 130, 143
MAX_ERROR_LINES = 5
TABLE_WIDTH = 100

app = typer.Typer(
    name="station",
    help="Watch a marked mechanism move, discover its joints, and compare the detected angles with the commands.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class Method(StrEnum):
    """Methods of the fit."""

    station = "station"
    paper = "paper"


Out = Annotated[Path, typer.Option("--out", help="Folder for the result; must be new or empty.", show_default=False)]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is in the folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[
    int | None, typer.Option("--seed", help="Seed of everything random in a simulation.", show_default=False)
]
Realtime = Annotated[bool, typer.Option("--realtime", help="Simulate on the real clock instead of a virtual one.")]
Simulate = Annotated[
    bool, typer.Option("--simulate", help="Emulated servos and a rendered camera, whatever the rig names.")
]
RigArgument = Annotated[
    str, typer.Argument(metavar="RIG", help="Rig: a file, or the name of a packaged one such as demo.")
]
MotionArgument = Annotated[str, typer.Argument(metavar="MOTION", help="Motion: a file, or the name of a packaged one.")]
SessionArgument = Annotated[Path, typer.Argument(metavar="SESSION", help="Session folder.", show_default=False)]
Commands = Annotated[
    Path | None, typer.Option("--commands", help="commands.csv of another clock, in place of the recorded commands.")
]


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"station {version('capture-fit-station')}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Options of all commands; --debug is taken out by `main`, which catches the errors."""


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Session folder; must be new or empty.")] = Path("demo"),
    seed: Seed = None,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run the whole station without hardware, to Figure 7.

    Captures the packaged demo motion on an emulated arm and a rendered camera, fits the recording, and compares the
    detected joint angles with the commands and the read-back.
    """
    _run("demo", "demo", out, as_json, seed=seed, realtime=realtime, force=force)


@app.command()
def run(
    rig: RigArgument,
    motion: MotionArgument,
    out: Out,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Capture, fit, compare and report in one go."""
    _run(rig, motion, out, as_json, seed=seed, simulate=simulate, realtime=realtime, force=force)


def _run(rig: str, motion: str, out: Path, as_json: bool, **settings: Any) -> None:
    from station import commands

    with _saying_what_is_left(out), _progress() as bar:
        comparison = commands.run(rig, motion, out, stage=bar.stage, progress=bar.update, **settings)
    _show_comparison(comparison, as_json)
    _next(
        f"Figure 7      {out / 'report' / 'figure7.png'}",
        f"report        {out / 'report' / 'report.html'}",
        f"tree          {out / 'fit' / 'kinematics.json'}",
        f"recording     station view {out}",
    )


@app.command()
def capture(
    rig: RigArgument,
    motion: MotionArgument,
    out: Out,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run a motion on a rig and record it into a session folder."""
    from station import commands

    with _saying_what_is_left(out), _progress() as bar:
        bar.stage("capture")
        counts = commands.capture(
            rig, motion, out, seed=seed, simulate=simulate, realtime=realtime, force=force, progress=bar.update
        )
    if as_json:
        print(json.dumps(counts.as_dict()))
    else:
        for name, number in counts.as_dict().items():
            print(f"{name.replace('_', ' '):16} {number}")
    _next(f"fit it        station fit {out}")


@app.command()
def fit(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="Session folder, recording.rrd, or a log of poses.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the result, new or empty; for a session its fit/.")
    ] = None,
    method: Annotated[Method, typer.Option("--method", help="How to fit.")] = Method.station,
    criterion: Annotated[
        str, typer.Option("--criterion", help="Selection criterion: evidence, bic, aic, aicc, paper-aic.")
    ] = "evidence",
    joint_types: Annotated[
        str,
        typer.Option(
            "--joint-types", help="Candidates, comma-separated, of rigid, prismatic, revolute, screw, spherical, free."
        ),
    ] = "rigid,prismatic,revolute",
    root: Annotated[
        str | None, typer.Option("--root", help="Part at the root of the tree.", show_default=False)
    ] = None,
    include_reference: Annotated[
        bool, typer.Option("--include-reference", help="Take the frame of the poses for a static part.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Discover the kinematic tree in a session or a log of poses.

    Reads a session folder, a recording.rrd, poses.csv, TUM files, plain tracks (x y z qx qy qz qw) and the ArUco
    library's old rows. Writes kinematics.json, joint_states.csv, kinematics.urdf and a drawing.
    """
    from station import commands
    from station.fit.options import FitOptions
    from station.fit_files import TREE_FILE

    options = FitOptions(
        method=method.value,
        criterion=criterion,
        joint_types=tuple(name.strip() for name in joint_types.split(",")),
        root=root,
        include_reference=include_reference,
    )
    result = commands.fit(source, out, options=options, force=force)
    if as_json:
        print((result.folder / TREE_FILE).read_text(encoding="utf-8"))
    else:
        _show_tree(result.fit.tree)
    for notice in (*result.notices, *result.fit.tree.warnings):
        _warn(notice)
    _next(f"tree          {result.folder / TREE_FILE}", f"drawing       {result.folder / 'tree.png'}")


@app.command()
def compare(session: SessionArgument, commands_csv: Commands = None, as_json: Json = False) -> None:
    """Compare detected joint angles with commands and read-back.

    Errors are after one sign and one offset a joint; lag and gain are estimated and shown beside. Writes
    comparison.csv and comparison.json into the session's report/.
    """
    from station import commands

    _show_comparison(commands.compare(session, commands=commands_csv), as_json)


@app.command()
def report(session: SessionArgument, commands_csv: Commands = None, as_json: Json = False) -> None:
    """Write a session's report: Figure 7, tables, the tree."""
    from station import commands

    _show_comparison(commands.report(session, commands=commands_csv), as_json)
    _next(f"report        {session / 'report' / 'report.html'}")


@app.command()
def view(session: SessionArgument) -> None:
    """Open a session in the rerun viewer."""
    from station import commands

    commands.view(session)


@app.command()
def plan(rig: RigArgument, motion: MotionArgument, as_json: Json = False) -> None:
    """Check a whole motion against a rig's limits; nothing moves.

    Prints what will be commanded when.
    """
    from station import commands

    planned = commands.plan(rig, motion)
    rows = commands.plan_rows(planned)
    if as_json:
        print(json.dumps(commands.plan_document(planned), allow_nan=False))
        return
    _table(f"motion '{planned.motion.name}' on {rig}: {planned.duration_s:.1f} s, within all limits", rows)


def _show_comparison(comparison: Comparison, as_json: bool) -> None:
    from station.comparison_files import comparison_json
    from station.report import summary_rows

    if as_json:
        print(comparison_json(comparison))
        return
    _table("Detected against read-back and command, after sign and offset only", summary_rows(comparison))
    for name in comparison.unmatched_commanded:
        _warn(f"{name}: no detected joint follows it")
    for name in comparison.unmatched_fitted:
        _warn(f"{name}: detected, but follows no command")


def _show_tree(tree: KinematicTree) -> None:
    from station.report import tree_rows

    _table(f"{len(tree.bodies)} bodies of {len(tree.parts)} tracked parts, root {tree.root}", tree_rows(tree))
    for group in tree.rigid_groups:
        print(f"one body: {', '.join(group)}")


def _table(title: str, rows: list[list[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for name, *cells in zip(*rows, strict=True):
        words = any(cell[:1].isalpha() for cell in cells)
        last = name == rows[0][-1]
        table.add_column(Text(name), justify="left" if words else "right", no_wrap=not (words and last))
    for row in rows[1:]:
        table.add_row(*map(Text, row))
    console = Console()
    Console(width=None if console.is_terminal else TABLE_WIDTH).print(table)


def _next(*lines: str) -> None:
    print("\n".join(lines), file=sys.stderr)


def _warn(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


class _Bar:
    """Progress on the terminal: a bar while capturing, a name while computing; silent where no person looks."""

    def __init__(self, progress: Any) -> None:
        self._progress = progress
        self._task: Any = None

    def stage(self, name: str) -> None:
        self.finish()
        self._task = self._progress.add_task(name, total=None)

    def finish(self) -> None:
        if self._task is not None:
            total = self._progress.tasks[self._task].total or 1
            self._progress.update(self._task, total=total, completed=total)

    def hide(self) -> None:
        for task in self._progress.task_ids:
            self._progress.update(task, visible=False)

    def update(self, done_s: float, total_s: float) -> None:
        self._progress.update(self._task, completed=done_s, total=total_s)


@contextmanager
def _progress() -> Iterator[_Bar]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description:8}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = _Bar(progress)
        try:
            yield bar
        except BaseException:
            bar.hide()
            raise
        bar.finish()


@contextmanager
def _saying_what_is_left(out: Path) -> Iterator[None]:
    """After a signal, tell that the recording is whole, if there is one."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if (out / "session.json").exists():
            _next(f"stopped; what was recorded is in {out}, fit it with: station fit {out}")
        raise


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

"""The camera's calibration: a wizard on the terminal, and its result."""

from __future__ import annotations

import json
import select
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import calibrate
from station.cli.options import Force, Json
from station.cli.show import say_next, table, warn

if TYPE_CHECKING:
    from calibration.camera_calibration import CameraCalibration
    from calibration.view_selection import ViewSelector
    from station.commands.cameras import Calibrated, Progress

TAKEN = "TAKEN"
COLUMNS = 80
# How many corners a cell of the image has, in characters.
SHADES = ((0, "  "), (1, ".."), (4, "::"), (10, "##"))


@calibrate.command()
def camera(
    source: Annotated[
        str | None,
        typer.Argument(
            metavar="SOURCE",
            help="Folder of images, video, or live camera: index, device, address; 'rendered' tries it without one.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder for the result; must be new or empty.")] = Path("camera"),
    board: Annotated[
        str | None,
        typer.Option(
            "--board",
            help="board.toml, or the description printed on the sheet; the board.toml beside SOURCE.",
            show_default=False,
        ),
    ] = None,
    measured_mm: Annotated[
        str | None,
        typer.Option("--measured-mm", help="What the 100 mm rulers measure, ACROSSxDOWN, such as 99.6x99.9."),
    ] = None,
    rig: Annotated[str | None, typer.Option("--rig", help="Whose camera it is: its source, size and settings.")] = None,
    size: Annotated[
        str | None, typer.Option("--size", help="Size to ask a live camera for, such as 1280x720.", show_default=False)
    ] = None,
    fps: Annotated[float | None, typer.Option("--fps", help="Frames a second to ask for.", show_default=False)] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Calibrate a camera from views of a printed board, live or stored.

    Live, it takes a view whenever the board is still, sharp and somewhere new, and says which to show next; Enter ends
    it early. Writes camera.toml, calibration.json, coverage.png and the views. Exit code 1 if the calibration is bad.
    """
    from station.commands import cameras

    found = cameras.read_board(board, source)
    if measured_mm is None and not found.measured and sys.stdin.isatty():
        measured_mm = _ask_ruler()
    ruler = None if measured_mm is None else cameras.parse_ruler(measured_mm)
    printed, size_px = cameras.require_measured(found, ruler), _size(size)
    with _saying_what_is_left(out), _wizard() as wizard:
        done = cameras.calibrate_camera(
            source, printed, out, rig=rig, size_px=size_px, fps=fps, force=force,
            on_look=wizard.show, stop=wizard.wants_end, say=wizard.stage,
        )  # fmt: skip
    for notice in done.notices:
        warn(notice)
    _show(done, as_json)
    if done.calibration.verdict.grade.word == "bad":
        raise typer.Exit(1)


@contextmanager
def _saying_what_is_left(out: Path) -> Iterator[None]:
    """After a signal, tell of the views that a live camera gave."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if (out / "views").is_dir() and not (out / "camera.toml").exists():
            views = shlex.quote(str(out / "views"))
            say_next(f"stopped; calibrate with the views so far: station calibrate camera {views} --out {out} --force")
        raise


def _ask_ruler() -> str:
    """What the person measures on the sheet."""
    across = typer.prompt("The printed ruler ACROSS the sheet should be 100 mm. What does it measure, in mm?", err=True)
    down = typer.prompt("And the one DOWN the sheet?", err=True)
    return f"{across}x{down}"


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise typer.BadParameter(f"--size {text}: want width x height, such as 1280x720")
    return int(width), int(height)


class Wizard:
    """What a person sees while views are taken: where corners were seen, what became of the last frame, what to do.

    Args:
        draw: shows lines of text in place of the last ones; None where no person looks.
        bar: the progress of stored images, and of the fit.
    """

    def __init__(self, draw: Callable[[list[str]], None] | None, stage: Callable[[str], None]) -> None:
        self._draw = draw
        self.stage = stage

    def show(self, progress: Progress) -> None:
        """Show the state after a frame; where no person looks, a line for each view."""
        if self._draw is not None:
            self._draw(wizard_lines(progress))
        elif progress.look.taken:
            say_next(f"{progress.look.why} of frame {progress.frame}")

    def wants_end(self) -> bool:
        """Whether somebody pressed Enter."""
        if self._draw is None or not sys.stdin.isatty():
            return False
        ready, _, _ = select.select([sys.stdin], [], [], 0)
        return bool(ready) and bool(sys.stdin.readline())


def wizard_lines(progress: Progress) -> list[str]:
    """The wizard's screen as lines of at most 80 columns."""
    selector, look = progress.selector, progress.look
    count = f"frame {progress.frame}" + ("" if progress.frames is None else f" of {progress.frames}")
    advice = selector.advice() or "nothing more is wanted"
    lines = [f"{len(selector.shots)} views, {count}", *cover_lines(selector)]
    for label, words in (("now:  ", _now(progress)), ("next: ", advice)):
        lines += textwrap.wrap(words, COLUMNS, initial_indent=label, subsequent_indent=" " * len(label))
    return [*lines, TAKEN if look.taken else ""]


def _now(progress: Progress) -> str:
    look = progress.look
    if look.quality is None:
        return look.why
    return f"{look.why} (tilt {_degrees(look.quality.tilt_rad)}, edges {look.quality.blur_px:.1f} px)"


def _degrees(angle_rad: float) -> str:
    return f"{angle_rad * 180 / 3.141592653589793:.0f} deg"


def cover_lines(selector: ViewSelector) -> list[str]:
    """The image as a grid of cells, darker the more corners were seen in them."""
    rows = ["".join(_shade(int(count)) for count in row) for row in selector.cover]
    edge = "+" + "-" * len(rows[0]) + "+"
    return [edge, *(f"|{row}|" for row in rows), edge]


def _shade(count: int) -> str:
    return [text for least, text in SHADES if count >= least][-1]


@contextmanager
def _wizard() -> Iterator[Wizard]:
    """A screen that is drawn anew where a person looks; plain lines elsewhere."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Wizard(None, lambda name: None)
        return
    with Live(console=console, refresh_per_second=8, transient=False) as live:

        def draw(lines: list[str]) -> None:
            if lines[-1] == TAKEN:
                console.bell()
            live.update(Text("\n".join(lines)))

        yield Wizard(draw, lambda name: live.update(Text(f"{name} ...")) if name == "fit" else None)


def _show(done: Calibrated, as_json: bool) -> None:
    from station.calibrating.files import COVER_FILE, result_document

    result = done.calibration
    if as_json:
        print(json.dumps({"camera": str(done.camera_file), **result_document(result)}, allow_nan=False))
    else:
        table(f"{done.camera_file.name}: {result.verdict.grade.word}", _rows(result))
        print(_summary(result))
        for remark in result.verdict.remarks:
            print(f"{remark.grade.word}: {remark.what}\n  {remark.do}")
    say_next(
        f'next: put calibration = "{done.camera_file}" under [camera] in the rig',
        f"where the views saw the board: {done.folder / COVER_FILE}",
        f"again from the stored views: {done.again}",
    )


def _rows(result: CameraCalibration) -> list[list[str]]:
    from calibration.camera_fit import PARAMETERS, parameters_of

    fit = result.fit
    rows = [["", "value", "std"]]
    for name, value, std in zip(PARAMETERS, parameters_of(fit.camera), fit.std, strict=True):
        digits = 2 if name[0] in "fc" else 5
        rows.append([f"{name} [px]" if name[0] in "fc" else name, f"{value:.{digits}f}", f"{std:.{digits}f}"])
    if result.edge_shift is not None:
        rows.append(["edge shift [px]", f"{result.edge_shift.shift_px:.3f}", f"{result.edge_shift.std_px:.3f}"])
    return rows


def _summary(result: CameraCalibration) -> str:
    held_out = "" if result.held_out is None else f", {result.held_out.rms_px:.3f} px in views left out"
    return (
        f"{len(result.shots)} views, {int(result.fit.used.sum())} corners: {result.camera.rms_px:.3f} px RMS{held_out}"
        + (f"; left out: {', '.join(result.left_out)}" if result.left_out else "")
    )

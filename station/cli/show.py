"""What people see on a terminal: tables, progress, warnings, what to do next."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from station.compare import Comparison

TABLE_WIDTH = 100


def table(title: str, rows: list[list[str]]) -> None:
    """Print rows, the header first, as a table that fits the terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for name, *cells in zip(*rows, strict=True):
        words = any(cell[:1].isalpha() for cell in cells)
        last = name == rows[0][-1]
        grid.add_column(Text(name), justify="left" if words else "right", no_wrap=not (words and last))
    for row in rows[1:]:
        grid.add_row(*map(Text, row))
    console = Console()
    Console(width=None if console.is_terminal else TABLE_WIDTH).print(grid)


def say_next(*lines: str) -> None:
    """Say on standard error what there is now and what can be done with it."""
    try:
        print("\n".join(lines), file=sys.stderr)
    except OSError:  # the terminal is gone, which mustn't become the command's exit code
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        os.close(nowhere)


def warn(text: str) -> None:
    """Say what is doubtful about a result."""
    print(f"warning: {text}", file=sys.stderr)


class Bar:
    """Progress on the terminal: a bar while capturing, a name while computing; silent where no person looks."""

    def __init__(self, progress: Any) -> None:
        self._progress = progress
        self._task: Any = None

    def stage(self, name: str) -> None:
        """The next piece of work begins."""
        self.finish()
        self._task = self._progress.add_task(name, total=None)

    def rename(self, name: str) -> None:
        """The present piece of work has come to something else."""
        self._progress.update(self._task, description=name)

    def finish(self) -> None:
        """The present piece of work is done."""
        if self._task is not None:
            total = self._progress.tasks[self._task].total or 1
            self._progress.update(self._task, total=total, completed=total)

    def hide(self) -> None:
        """Take all bars away."""
        for task in self._progress.task_ids:
            self._progress.update(task, visible=False)

    def count(self, done: int, total: int, what: str) -> None:
        """How many of all pieces of work are done; what was done before counts for no speed."""
        if self._progress.tasks[self._task].total is None:
            self._progress.reset(self._task, total=total, completed=done)
        self._progress.update(self._task, completed=done, total=total, description=f"{done} of {total} {what}")

    def update(self, done_s: float, total_s: float) -> None:
        """How far the present piece of work has come."""
        self._progress.update(self._task, completed=done_s, total=total_s)


@contextmanager
def progress() -> Iterator[Bar]:
    """A bar on standard error while the block runs."""
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
    with Progress(*columns, console=console, disable=not console.is_terminal) as shown:
        bar = Bar(shown)
        try:
            yield bar
        except BaseException:
            bar.hide()
            raise
        bar.finish()


def show_comparison(comparison: Comparison, as_json: bool) -> None:
    """Print a comparison: as a table, with what it leaves open, or as JSON."""
    from station.comparison_files import comparison_json
    from station.report import session_lag_text, summary_rows

    if as_json:
        print(comparison_json(comparison))
        return
    told = not comparison.joints or any(joint.against_commanded is not None for joint in comparison.joints)
    against = "read-back and command" if told else "read-back (there are no commands)"
    table(f"Detected against {against}, after sign, offset and the session's lag", summary_rows(comparison))
    if comparison.joints:
        print(session_lag_text(comparison))
    for name in comparison.unmatched_commanded:
        warn(f"{name}: no detected joint follows it")
    for name in comparison.unmatched_fitted:
        warn(f"{name}: detected, but follows no joint of the arm")


def asking(yes: bool) -> Callable[[str], None]:
    """Tells a person what happens next and waits for Enter; with `yes` it tells and goes on.

    Raises:
        InvalidData: where there is no person to ask, or they say no.
    """
    from station.errors import InvalidData

    def ask(text: str) -> None:
        if yes:
            say_next(text)
            return
        if not sys.stdin.isatty():
            raise InvalidData(f"nobody can be asked here\n{text}\nrun it on a terminal, or say --yes")
        say_next(f"{text}, then press Enter (n and Enter: stop)")  # a whole line: a bar may be under way
        if sys.stdin.readline().strip().lower() not in ("", "y", "yes"):
            raise InvalidData("stopped; nothing was changed")

    return ask


@contextmanager
def saying_what_is_left(out: Path) -> Iterator[None]:
    """After a signal, tell that the recording is whole, if there is one."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if (out / "session.json").exists():
            say_next(f"stopped; what was recorded is in {out}, fit it with: station fit {out}")
        raise

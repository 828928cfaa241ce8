"""Pictures of a capture as a person sees it: the terminal's dashboard and the live view, of a run of the demo.

    python -m tests.benchmarks.live_pictures docs/dashboard.png docs/live.png

Needs a Vulkan adapter; the run is on the virtual clock, paused while its pictures are taken.
"""

from __future__ import annotations

import io
import re
import sys
import tempfile
import threading
import time
from pathlib import Path

import matplotlib
import resvg_py
from rerun.experimental import ViewerClient
from rich.console import Console

from station.capture.control import Control
from station.capture.snapshot import Snapshot
from station.capture.states import State
from station.cli.attending import Disk
from station.cli.dashboard import Dashboard
from station.commands import capturing
from station.commands.live import live_server
from station.recording.live import HOST
from station.view import Viewer

PICTURE_AT_S = 12.0
SIZE_PX = "1600x1000"
STILL_S = 2.0


def draw_dashboard(dashboard: Dashboard, path: Path) -> None:
    """The dashboard on a terminal of 80 columns."""
    console = Console(record=True, width=80, force_terminal=True, file=io.StringIO(), color_system="truecolor")
    console.print(dashboard)
    svg = console.export_svg(title="station capture")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL).replace("Fira Code", "DejaVu Sans Mono")
    fonts = [str(font) for font in (Path(matplotlib.get_data_path()) / "fonts" / "ttf").glob("DejaVuSansMono*.ttf")]
    path.write_bytes(bytes(resvg_py.svg_to_bytes(svg_string=svg, font_files=fonts)))


def shoot(address: str, png: Path, resume: Control) -> None:
    """A picture of the live view, once it no longer changes."""
    with Viewer(["--hide-welcome-screen", "--window-size", SIZE_PX], headless=True) as viewer:
        viewer.show(address)
        client = ViewerClient.connect(f"rerun+http://{HOST}:{viewer.port}/proxy")
        before = b""
        while True:
            time.sleep(STILL_S)
            client.save_screenshot(str(png.resolve()))
            if before == (before := png.read_bytes()):
                break
        print([(view.name, [report.summary for report in view.reports]) for view in client.get_state().views])
    resume.stop()


def main() -> None:
    """Make both pictures."""
    dashboard_png, live_png = map(Path, sys.argv[1:])
    control, seen = Control(), threading.Event()
    kept: list[Snapshot] = []

    def watch(snapshot: Snapshot) -> None:
        if snapshot.done_s >= PICTURE_AT_S and not kept:
            kept.append(snapshot)
            control.pause()
        if snapshot.state is State.PAUSED:
            seen.set()

    with tempfile.TemporaryDirectory() as folder, live_server(opens=False) as live:
        out = Path(folder) / "session"
        settings = {"control": control, "watch": watch, "live": live}
        capture = threading.Thread(target=lambda: capturing.capture("demo", "demo", out, **settings))
        capture.start()
        seen.wait()
        foot = f"Ctrl-C pauses   live view {live.address}"
        draw_dashboard(Dashboard(kept[0], Disk(out).text(), "", foot), dashboard_png)
        shoot(live.address, live_png, control)
        capture.join()


if __name__ == "__main__":
    main()

"""Pages of black rectangles, thin lines and small print in millimetres, written as vector PDF and SVG at 100 %.

All black rectangles of a page are one path: viewers that smooth edges leave no seams within a path. The PDF asks
viewers not to scale the page (PrintScaling None; ISO 32000-1, table 150), which not all of them heed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape

from calibration.intrinsics import FloatArray

PT_PER_MM = 72.0 / 25.4
PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4), "a3": (297.0, 420.0)}
# Mean width of Helvetica's letters, as share of the font's size: for room, not for layout.
LETTER_WIDTH = 0.52


@dataclass(frozen=True)
class Line:
    """A line from (x1, y1) to (x2, y2), mm."""

    x1: float
    y1: float
    x2: float
    y2: float
    width: float = 0.15


@dataclass(frozen=True)
class Text:
    """A line of small print; (x, y) is the left end of its base line, mm; `upward` runs it up the page."""

    x: float
    y: float
    size: float
    text: str
    upward: bool = False


@dataclass(frozen=True, eq=False)
class Page:
    """A page: (width, height) in mm, origin top left, y down; black rectangles are (K, 4) `x, y, width, height`."""

    size_mm: tuple[float, float]
    rectangles_mm: FloatArray
    lines: Sequence[Line] = field(default_factory=tuple)
    texts: Sequence[Text] = field(default_factory=tuple)


def svg(page: Page) -> str:
    """The page as an SVG document whose size is in millimetres."""
    width, height = page.size_mm
    path = " ".join(f"M{x:.5f} {y:.5f}h{w:.5f}v{h:.5f}h{-w:.5f}z" for x, y, w, h in page.rectangles_mm.tolist())
    lines = "\n".join(
        f'<line x1="{line.x1:.4f}" y1="{line.y1:.4f}" x2="{line.x2:.4f}" y2="{line.y2:.4f}" '
        f'stroke="black" stroke-width="{line.width}"/>'
        for line in page.lines
    )
    texts = "\n".join(_svg_text(text) for text in page.texts)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>\n'
        f'<path fill="black" d="{path}"/>\n{lines}\n{texts}\n</svg>\n'
    )


def _svg_text(text: Text) -> str:
    turn = f' transform="rotate(-90 {text.x:.4f} {text.y:.4f})"' if text.upward else ""
    return (
        f'<text x="{text.x:.4f}" y="{text.y:.4f}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{text.size:g}"{turn}>{escape(text.text)}</text>'
    )


def pdf(pages: Sequence[Page], title: str) -> bytes:
    """The pages as one PDF document (1.4), in vectors, with Helvetica, which every reader has."""
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{' '.join(f'{5 + 2 * k} 0 R' for k in range(len(pages)))}] /Count {len(pages)} >>",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        f"<< /Title ({_pdf_string(title)}) /Producer (station board) >>",
    ]
    for k, page in enumerate(pages):
        width, height = (PT_PER_MM * side for side in page.size_mm)
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] "
            f"/Resources << /Font << /F1 3 0 R >> >> /Contents {6 + 2 * k} 0 R >>"
        )
        content = _pdf_content(page).encode("cp1252", "replace")
        objects.append(b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content))
    return _pdf_file([body if isinstance(body, bytes) else body.encode("cp1252", "replace") for body in objects])


def _pdf_file(objects: Sequence[bytes]) -> bytes:
    """Objects 1, 2, ... with the table of where they begin (ISO 32000-1, 7.5)."""
    out = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    places: list[int] = []
    for number, body in enumerate(objects, start=1):
        places.append(len(out))
        out += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info 4 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)


def _pdf_content(page: Page) -> str:
    """The page's drawing; PDF has its origin at the bottom left, y up, in points."""
    height = page.size_mm[1]
    parts = ["0 g 0 G"]
    for x, y, w, h in page.rectangles_mm.tolist():
        low = height - y - h
        parts.append(f"{_pt(x)} {_pt(low)} {_pt(w)} {_pt(h)} re")
    parts.append("f")
    for line in page.lines:
        ends = f"{_pt(line.x1)} {_pt(height - line.y1)} m {_pt(line.x2)} {_pt(height - line.y2)} l"
        parts.append(f"{_pt(line.width)} w {ends} S")
    for text in page.texts:
        turn = "0 1 -1 0" if text.upward else "1 0 0 1"
        place = f"{_pt(text.x)} {_pt(height - text.y)}"
        parts.append(f"BT /F1 {_pt(text.size)} Tf {turn} {place} Tm ({_pdf_string(text.text)}) Tj ET")
    return "\n".join(parts)


def _pt(mm: float) -> str:
    return f"{PT_PER_MM * mm:.4f}"


def _pdf_string(text: str) -> str:
    return text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")

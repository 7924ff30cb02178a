"""A board as a PDF page at true size: vector black, a ruler to check the printer with, and the spec to type in again.

In: a `Board` and a page.  Out: the file's bytes, the same for the same board.  PDF 1.4 (ISO 32000-1), millimetres inside."""

from __future__ import annotations

from stereorelight.calibration.board import Board
from stereorelight.errors import ShotError, nearest_hint

PAGES_MM = {
    "A4": (210, 297),
    "A3": (297, 420),
    "A2": (420, 594),
    "A1": (594, 841),
    "A0": (841, 1189),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
SERIES = ("A4", "A3", "A2", "A1", "A0")
MARGIN_MM = 7.0  # what printers leave white
FOOT_MM = 19.0  # ruler and words, and the printer's own margin below
RULER_MM = 100
POINTS_PER_MM = 72 / 25.4


def page_for(board: Board, page: str = "fit") -> tuple[str, float, float]:
    """(name, width, height) in millimetres of the page, upright or lying, that holds the board.

    page   : a name of PAGES_MM, "fit" for the smallest A page, "exact" for a page made for this board (print shops, plates).
    Raises : ShotError naming the page that would do.
    """
    x0, y0, x1, y1 = board.extent_m
    rim = max(1000 * board.quiet_m, MARGIN_MM)
    wide, high = 1000 * (x1 - x0) + 2 * rim, 1000 * (y1 - y0) + 2 * rim + FOOT_MM
    wide = max(wide, RULER_MM + 2 * MARGIN_MM + 4)

    def fits(name: str) -> tuple[str, float, float] | None:
        a, b = PAGES_MM[name]
        for w, h in ((a, b), (b, a)):
            if wide <= w and high <= h:
                return name, float(w), float(h)
        return None

    named = {name.lower(): name for name in (*PAGES_MM, "fit", "exact")}
    if page.lower() not in named:
        raise ShotError(f"page {page!r} is unknown{nearest_hint(page, named.values())}")
    page = named[page.lower()]
    if page == "exact":
        return f"{wide:.0f}x{high:.0f} mm", wide, high
    smallest = next((found for name in SERIES if (found := fits(name))), None)
    chosen = smallest if page == "fit" else fits(page)
    if chosen is None:
        remedy = f"take page {smallest[0]}, or smaller squares" if smallest else "take page 'exact' and a print shop, or smaller squares"
        asked = "no page up to A0" if page == "fit" else f"page {page} does not"
        holds = "holds" if page == "fit" else "hold"
        raise ShotError(f"{asked} {holds} {board.spec}, which needs {wide:.0f}x{high:.0f} mm with its white rim; {remedy}")
    return chosen


def board_pdf(board: Board, page: str = "fit") -> bytes:
    """The printable page of `board`, see `page_for`."""
    name, width, height = page_for(board, page)
    x0, y0, x1, y1 = board.extent_m
    rim = max(1000 * board.quiet_m, MARGIN_MM)
    left = (width - 1000 * (x1 - x0)) / 2
    top = rim + (height - FOOT_MM - 1000 * (y1 - y0) - 2 * rim) / 2

    def rectangle(x: float, y_down: float, w: float, h: float) -> str:
        return f"{x:.4f} {height - y_down - h:.4f} {w:.4f} {h:.4f} re"

    black = [rectangle(left + 1000 * (a - x0), top + 1000 * (b - y0), 1000 * (c - a), 1000 * (d - b)) for a, b, c, d in board.rectangles_m.tolist()]
    # Everything black is one path filled once: pieces that touch leave no hairline between them.
    foot = height - FOOT_MM + 4
    rule = (width - RULER_MM) / 2
    ruler = [rectangle(rule, foot, RULER_MM, 0.2)]
    ruler += [
        rectangle(rule + mm - 0.075, foot - (3 if mm % 50 == 0 else 2 if mm % 10 == 0 else 1), 0.15, 3 if mm % 50 == 0 else 2 if mm % 10 == 0 else 1)
        for mm in range(0, RULER_MM + 1, 5)
    ]
    words = [
        (2.6, foot + 3.6, f"This line must measure {RULER_MM} mm. Print at 100 % (no 'fit to page'), measure, mount flat."),
        (2.6, foot + 7.4, f"stereorelight --board {board.spec}   ({name})"),
    ]
    text = [f"BT /F1 {size:.2f} Tf {width / 2 - 0.25 * size * len(line):.3f} {height - y:.3f} Td ({_escaped(line)}) Tj ET" for size, y, line in words]
    content = "\n".join([f"{POINTS_PER_MM:.10f} 0 0 {POINTS_PER_MM:.10f} 0 0 cm", "0 g", *black, "f", *ruler, "f", *text, ""]).encode("ascii")
    box = f"[0 0 {width * POINTS_PER_MM:.4f} {height * POINTS_PER_MM:.4f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        f"<< /Length {len(content)} >>\nstream\n".encode("ascii") + content + b"endstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        f"<< /Title ({_escaped(board.spec)}) /Creator (stereorelight) >>".encode("ascii"),
    ]
    out, places = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"), []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += f"{number} 0 obj\n".encode("ascii") + body + b"\nendobj\n"
    start = len(out)
    out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode("ascii")
    out += b"".join(f"{place:010d} 00000 n \n".encode("ascii") for place in places)
    out += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R /Info 6 0 R >>\nstartxref\n{start}\n%%EOF\n".encode("ascii")
    return bytes(out)


def _escaped(line: str) -> str:
    return line.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")

"""A calibration as one self-contained HTML page: figures, and the pictures that a person looks at to believe them.

In: a `Session`.  Out: the page's text.  Drawings are SVG made here from numbers; nothing is fetched from anywhere."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from html import escape

import numpy as np
import numpy.typing as npt

from stereorelight import __version__
from stereorelight.arrays import Float32
from stereorelight.calibration.uncertainty import coverage, projection_sigma, standard_errors
from stereorelight.camera import Eye
from stereorelight.footage.stills import png_bytes
from stereorelight.shot.calibrate import Session
from stereorelight.shot.check_page import page_template
from stereorelight.shot.check_pictures import rows_picture
from stereorelight.shot.pairs import EYES
from stereorelight.stereo.rectify import rectification

ARROW_SHARE = 0.012  # of the frame's width: how long the middling residual is drawn
EYE_PX = 800  # width of an eye in the picture of the rectified pair
DARK, BRIGHT = (38, 44, 66), (244, 208, 96)


def _mixed(share: float) -> str:
    t = min(max(share, 0.0), 1.0)
    return "#" + "".join(f"{round(a + (b - a) * t):02x}" for a, b in zip(DARK, BRIGHT))


def _svg(width: float, height: float, parts: Iterable[str]) -> str:
    return f'<svg viewBox="0 0 {width:g} {height:g}" role="img">{"".join(parts)}</svg>'


def _cells(values: npt.ArrayLike, size: tuple[int, int], top: float) -> str:
    """A map over the frame: dark is 0, bright is `top` and more; unknown cells stay empty."""
    a = np.asarray(values, dtype=np.float64)
    w, h = size[0] / a.shape[1], size[1] / a.shape[0]
    known = [(r, c, float(a[r, c])) for r, c in np.ndindex(*a.shape) if np.isfinite(a[r, c])]
    cells = (
        f'<rect x="{c * w:.1f}" y="{r * h:.1f}" width="{w + 0.5:.1f}" height="{h + 0.5:.1f}" fill="{_mixed(v / top)}"></rect>' for r, c, v in known
    )
    return _svg(*size, ('<g shape-rendering="crispEdges">', *cells, "</g>"))


def _longer(session: Session) -> int:
    """How many times longer the arrows are drawn than the errors are: 1, 2 or 5 times a power of ten."""
    off = np.linalg.norm(session.calibration.residual_px, axis=-1)
    middling = float(np.median(off[np.isfinite(off)]))
    wanted = min(max(ARROW_SHARE * session.rig.left.size[0] / max(middling, 1e-6), 1.0), 5000.0)
    return max(n * 10**k for k in range(4) for n in (1, 2, 5) if n * 10**k <= wanted)


def _arrows(session: Session, eye: Eye) -> str:
    """Every corner's error, from where it was seen (a dot), drawn `_longer`; corners left out are red."""
    e, c = EYES.index(eye), session.calibration
    size = c.rig.camera(eye).size
    px, off, kept = c.views.px[e].reshape(-1, 2), c.residual_px[e].reshape(-1, 2), c.kept[e].ravel()
    seen = np.isfinite(px).all(axis=1) & np.isfinite(off).all(axis=1)
    stroke, longer = max(size) / 500, _longer(session)
    lines = (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{x + longer * dx:.1f}" y2="{y + longer * dy:.1f}" '
        f'stroke="{"#7db4e6" if k else "#ee7465"}" stroke-width="{stroke:.2f}"></line>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{1.2 * stroke:.2f}" fill="{"#7db4e6" if k else "#ee7465"}"></circle>'
        for (x, y), (dx, dy), k in zip(px[seen].tolist(), off[seen].tolist(), kept[seen].tolist())
    )
    return _svg(*size, lines)


def _bars(session: Session) -> str:
    """RMS of each view, left and right beside each other."""
    rms = session.calibration.view_rms_px
    top = float(np.nanmax(rms)) if np.isfinite(rms).any() else 1.0
    count, height = rms.shape[1], 200.0
    step = 720.0 / max(count, 1)
    parts = []
    for e, colour in enumerate(("#7db4e6", "#e8b64c")):
        for v, value in enumerate(rms[e].tolist()):
            if math.isfinite(value):
                tall = (height - 24) * value / top
                x = v * step + (0.1 + 0.4 * e) * step
                told = f"<title>{escape(session.names[v])}, {EYES[e]}: {value:.3f} px</title>"
                parts.append(f'<rect x="{x:.1f}" y="{height - tall:.1f}" width="{0.38 * step:.1f}" height="{tall:.1f}" fill="{colour}">{told}</rect>')
    parts.append(f'<line x1="0" y1="24" x2="720" y2="24" stroke="#33383e" stroke-width="1"></line><text x="4" y="18">{top:.3g} px</text>')
    return _svg(720, height, parts)


def _from_above(session: Session) -> str:
    """Both eyes and every board, seen from above: left camera at the middle below, looking up."""
    c = session.calibration
    corners = c.views.points_m
    ends = corners[[int(np.argmin(corners[:, 0])), int(np.argmax(corners[:, 0]))]]
    boards = [pose[:3, :3] @ ends.T + pose[:3, 3:] for pose in c.board_poses]
    boards = [b for b in boards if np.isfinite(b).all() and b[2].min() > 0]
    right = c.rig.right_centre_m
    deep = max((float(b[2].max()) for b in boards), default=1.0)
    wide = max([float(np.abs(b[0]).max()) for b in boards] + [abs(float(right[0])), 0.1 * deep])
    scale = min(300 / wide, 330 / deep)

    def at(x: float, z: float) -> tuple[float, float]:
        return 360 + scale * x, 370 - scale * z

    parts = []
    for b in boards:
        (x1, y1), (x2, y2) = at(b[0, 0], b[2, 0]), at(b[0, 1], b[2, 1])
        parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="#6cc08b" stroke-width="2"></line>')
    for eye, colour, centre, turn in zip(EYES, ("#7db4e6", "#e8b64c"), (np.zeros(3), right), (np.eye(3), c.rig.R_right_left.T)):
        (w, h), camera = c.rig.camera(eye).size, c.rig.camera(eye)
        x, y = at(centre[0], centre[2])
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"></circle>')
        for edge, stroke, reach in ((0, 1, 1.1), (w - 1, 1, 1.1), (None, 2, 0.15)):  # both edges of the frame, and the axis
            ray = turn @ (np.array([0, 0, 1.0]) if edge is None else camera.rays(np.array([edge, (h - 1) / 2])))
            if ray[2] > 0:
                u, v = at(*(centre + reach * deep * ray / ray[2])[[0, 2]])
                parts.append(f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}" stroke="{colour}" stroke-width="{stroke}"></line>')
    parts.append(f'<text x="8" y="16">the farthest corner is {deep:.2f} m away, the eyes are {1000 * c.rig.baseline_m:.1f} mm apart</text>')
    return _svg(720, 390, parts)


def _drawings(session: Session) -> list[tuple[str, str]]:
    c = session.calibration
    made: list[tuple[str, str]] = []
    for eye in EYES:
        size = c.rig.camera(eye).size
        seen = coverage(c, eye).astype(np.float64)
        seen[seen == 0] = np.nan
        made.append(
            (
                f"Coverage, {eye}: where corners lay, {int(np.nanmax(seen))} in the brightest cell; where none lay nothing was seen of the lens",
                _cells(seen, size, float(np.nanmax(seen))),
            )
        )
    for eye in EYES:
        made.append((f"Errors of the corners, {eye}, {_longer(session)} times longer; red: left out", _arrows(session, eye)))
    for eye in EYES:
        sigma = projection_sigma(c, eye)
        caption = f"Uncertainty of the {eye} eye far away, one sigma: bright is 1 px and more; worst {float(np.nanmax(sigma)):.2f} px"
        made.append((caption, _cells(sigma, c.rig.camera(eye).size, 1.0)))
    if session.quality.halves_px is not None:
        for eye, off in zip(EYES, session.quality.halves_px):
            caption = f"Odd and even views disagree, {eye}: bright is 1 px and more; worst {float(np.nanmax(off)):.2f} px"
            made.append((caption, _cells(np.abs(off), c.rig.camera(eye).size, 1.0)))
    made.append(("RMS of each view, px: left blue, right yellow", _bars(session)))
    made.append(("From above: left eye blue, right eye yellow, each with the edges of its frame; the boards green", _from_above(session)))
    return made


def _numbers(session: Session) -> list[tuple[str, str]]:
    """The rig in words, each with its standard error."""
    rig, errors = session.rig, standard_errors(session.calibration)
    told = [("baseline", f"{1000 * rig.baseline_m:.3f} ± {1000 * errors['baseline']:.3f} mm")]
    turn = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(rig.R_right_left)) - 1) / 2))))
    told.append(("right eye turned against the left", f"{turn:.4f} deg"))
    for eye in EYES:
        camera = rig.camera(eye)
        sigma = errors.get(f"{eye}.fx", 0.0)
        told.append((f"{eye} focal length", f"{camera.fx:.2f} x {camera.fy:.2f} ± {sigma:.2f} px"))
        told.append((f"{eye} principal point", f"{camera.cx:.2f}, {camera.cy:.2f} px"))
        told.append((f"{eye} lens", f"{camera.model}: {', '.join(f'{k:.5g}' for k in camera.distortion)}"))
    return told


def _views(session: Session) -> list[tuple[str, ...]]:
    c = session.calibration
    left_out = {(o.view, o.eye): o.reason for o in c.outliers if not o.ids}

    def number(value: float) -> str:
        return f"{value:.3f}" if math.isfinite(value) else ""

    rows = []
    for v, name in enumerate(session.names):
        why = "; ".join(f"{eye}: {left_out[v, eye]}" for eye in EYES if (v, eye) in left_out)
        rows.append((name, *(number(float(c.view_rms_px[e, v])) for e in (0, 1)), number(float(session.quality.held_out_by_view_px[v])), why))
    return rows


def _rectified(session: Session) -> list[tuple[str, str]]:
    made = rectification(session.rig)
    pictures: list[Float32] = []
    for picture, eye in zip(session.example, EYES):
        linear = np.ascontiguousarray(np.square(np.clip(picture, 0, 1)), dtype=np.float32)
        pictures.append(made.rectify(linear, eye))
    drawn = rows_picture(pictures[0], pictures[1], width_px=2 * EYE_PX)
    return [("The first view rectified: a corner lies on one line in both eyes", base64.b64encode(png_bytes(drawn)).decode())]


def calibrate_page(session: Session) -> str:
    """The page of `session`."""
    quality = session.quality
    facts = (
        f"{session.looked_at} pictures of each eye looked at",
        f"{len(session.names)} views solved",
        f"RMS {session.calibration.rms_px:.3f} px, {session.calibration.rms_all_px:.3f} px with all corners",
        f"lenses {', '.join(session.choice.lenses)}",
        f"square sides spread by {100 * quality.square_spread:.2f} %",
    )
    return page_template("calibrate.html.j2").render(
        s=session,
        facts=facts,
        numbers=_numbers(session),
        drawings=_drawings(session),
        pictures=_rectified(session),
        views=_views(session),
        version=__version__,
    )

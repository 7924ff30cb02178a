"""Which way a renderer's P and N point: axes of a camera or of a world, coded -1..1 or 0..1; found from the values, with the evidence in words.

In: raw P or N (H, W, 3), the rays of the camera, or normals of the same plate in the scene frame.  Out: an `Axes`, which takes the raw
vectors to the scene frame of the camera (x right, y up, it looks down -z), and the evidence.

P needs no other pass: a point lies on the ray of its own pixel, so the rays say what axes it has, and, if it is of a world, where the camera
stood (the direct linear transform of resection: Hartley and Zisserman, Multiple View Geometry, 7.1, with calibrated rays).
N is held against normals of the same plate, by the rotation that fits best (Kabsch 1976)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Float64
from stereorelight.errors import PassError, nearest_hint

SAMPLES = 8000
WORDS = {"right": (1, 0, 0), "left": (-1, 0, 0), "up": (0, 1, 0), "down": (0, -1, 0), "back": (0, 0, 1), "forward": (0, 0, -1)}
RAY_DEG, NORMAL_DEG = 0.2, 8.0  # what a point may lie off its ray, and a normal off one that was fitted to depth
LEAST_FIT = 0.5  # share that must fit
CLEAR = 1.3  # how many times more than otherwise
WINS = 0.7  # of the vectors on which two sets of axes differ, so many must go with one of them
REACH = 0.5  # of unit vectors: those farther apart are mistakes of the other pass, and all alike
LEAST_APART = 30
ONE_WAY = 0.02  # normals that all point one way, but for so much, tell nothing of a turn about it
COMMON = ("right up back", "right down forward")  # believed where normals all point one way
WORLD_FIT = 0.8  # share of points that must lie on their rays for a resection to be believed
RIGID = 0.02  # what a rotation's singular values may differ by: half floats, and a focal length that is right
UNIT_OFF = 0.05  # of a vector's length: anti-aliased and half-float normals are shorter
FLAT = 2e-3  # smallest against largest: points that all lie in one plane cannot place a camera


@dataclass(frozen=True, kw_only=True, eq=False)
class Axes:
    """From raw vectors to the scene frame of the camera: `matrix @ (2 v - 1 if coded else v) + shift`.

    matrix : (3, 3) orthogonal; a mirrored world has determinant -1.   shift : (3,) in the units of P, of points alone.
    coded  : the values are 0..1 for -1..1.
    """

    matrix: Float64 = field(default_factory=lambda: np.eye(3))
    shift: Float64 = field(default_factory=lambda: np.zeros(3))
    coded: bool = False

    def words(self) -> str:
        """`x right, y down, z forward`, or where the camera stands in a world."""
        named = axis_words(self.matrix)
        if named is not None and not np.any(np.abs(self.shift) > 1e-3):
            told = "axes of the camera: " + ", ".join(f"{letter} {word}" for letter, word in zip("xyz", named))
        else:
            centre = -self.matrix.T @ self.shift
            at = ", ".join(f"{v:.3g}" for v in centre)
            told = "axes of a world" + (f" in which the camera stands at ({at})" if np.any(self.shift) else "")
            told += ", left-handed" if np.linalg.det(self.matrix) < 0 else ""
        return told + (", coded 0..1" if self.coded else "")

    def points(self, raw: npt.NDArray[np.floating]) -> Float64:
        """(..., 3) points in the scene frame of the camera, in their own unit."""
        return self._decoded(raw) @ self.matrix.T + self.shift

    def normals(self, raw: npt.NDArray[np.floating]) -> Float64:
        """(..., 3) unit normals in the scene frame of the camera; NaN where the raw vector is none."""
        v = self._decoded(raw)
        length = np.linalg.norm(v, axis=-1, keepdims=True)
        with np.errstate(invalid="ignore", divide="ignore"):
            unit = np.where((length > 0.7) & (length < 1.2), v / length, np.nan)
        return unit @ self.matrix.T

    def _decoded(self, raw: npt.NDArray[np.floating]) -> Float64:
        v = np.asarray(raw, dtype=np.float64)
        return 2 * v - 1 if self.coded else v


@dataclass(frozen=True, kw_only=True)
class AxesReading:
    """What vectors were found to be: the axes, whether that is sure, the evidence in one line, and why not and what to state where not."""

    axes: Axes
    sure: bool
    words: str
    doubt: str = ""
    share: float = np.nan
    next_share: float = np.nan


def axis_words(matrix: Float64, *, within_deg: float = 0.5) -> tuple[str, str, str] | None:
    """Where x, y and z of the raw vectors point, by name; None where that is no axis of the camera."""
    names = []
    for column in matrix.T:
        word = max(WORDS, key=lambda w: float(np.dot(WORDS[w], column)))
        if float(np.dot(WORDS[word], column)) < np.cos(np.radians(within_deg)):
            return None
        names.append(word)
    return names[0], names[1], names[2]


def axes_named(text: str) -> Float64:
    """The matrix of "right,down,forward": where x, y and z of the raw vectors point.  Raises PassError where that is no set of axes."""
    names = [n for n in text.replace(",", " ").lower().split() if n not in ("x", "y", "z")]
    for name in names:
        if name not in WORDS:
            raise PassError(f"axes {text!r}: no direction is called {name!r}{nearest_hint(name, WORDS)}")
    matrix = np.array([WORDS[n] for n in names], dtype=np.float64).T if len(names) == 3 else np.zeros((3, 3))
    if abs(np.linalg.det(matrix)) < 0.5:
        raise PassError(f"axes {text!r}: say where x, y and z point, such as right,down,forward")
    return matrix


def all_axes() -> list[Float64]:
    """The 48 signed permutations, those of right-handed frames first."""
    out = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            m = np.zeros((3, 3))
            m[range(3), order] = signs
            out.append(m)
    return sorted(out, key=lambda m: -np.linalg.det(m))


def coding_of(raw: npt.NDArray[np.floating]) -> bool | None:
    """Whether vectors (H, W, 3) of unit length are coded 0..1; None where they have unit length neither way."""
    v = _known(raw)
    if v.shape[0] < 50:
        return None
    plain, coded = (float((np.abs(np.linalg.norm(a, axis=-1) - 1) < UNIT_OFF).mean()) for a in (v, 2 * v - 1))
    if max(plain, coded) < LEAST_FIT:
        return None
    return coded > plain


def _known(raw: npt.NDArray[np.floating]) -> Float64:
    flat = raw.reshape(-1, 3)
    at = np.flatnonzero(np.isfinite(flat).all(axis=-1) & (flat != 0).any(axis=-1))
    return flat[at[:: max(1, at.size // SAMPLES)]].astype(np.float64)


def _pairs(raw: npt.NDArray[np.floating], other: npt.NDArray[np.floating]) -> tuple[Float64, Float64]:
    """Samples (n, 3) of both where both are known."""
    a, b = raw.reshape(-1, 3), other.reshape(-1, other.shape[-1])
    known = np.isfinite(a).all(axis=-1) & np.isfinite(b).all(axis=-1) & (np.abs(a) < 1e9).all(axis=-1) & (a != 0).any(axis=-1)
    at = np.flatnonzero(known)
    at = at[:: max(1, at.size // SAMPLES)]
    return a[at].astype(np.float64), b[at].astype(np.float64)


def _unit(v: Float64) -> Float64:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def _share(a: Float64, b: Float64, within_deg: float) -> float:
    """Share of unit vectors (n, 3) that agree; sharper than arccos near 0."""
    apart = np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))
    return float((apart <= within_deg).mean())


def scene_rays(rays: npt.NDArray[np.floating]) -> Float64:
    """(..., 3) directions in the scene frame through rays (..., 2) of the camera frame: (x, -y, -1)."""
    r = np.asarray(rays, dtype=np.float64)
    return np.stack([r[..., 0], -r[..., 1], -np.ones(r.shape[:-1])], axis=-1)


def _best_axes(raw: Float64, other: Float64, within_deg: float) -> tuple[Float64, float, float, float]:
    """The axes that take unit `raw` to unit `other` best, their share, the share of the next best, and the least share of the vectors on
    which a rival points elsewhere that go with them; a rival that says the same of these vectors is none."""
    gram = other.T @ raw
    ranked = sorted(all_axes(), key=lambda m: -float((m * gram).sum()))[:12]
    off = [np.linalg.norm(raw @ m.T - other, axis=-1) for m in ranked]
    best = int(np.argmin([float(np.minimum(o, REACH).mean()) for o in off]))
    first, following, wins = raw @ ranked[best].T, 0.0, 1.0
    for i, m in enumerate(ranked):
        apart = np.linalg.norm(first - raw @ m.T, axis=-1) > 2 * np.radians(within_deg)
        if i == best or apart.sum() < max(LEAST_APART, 1e-3 * apart.size):
            continue
        following = max(following, _share(raw @ m.T, other, within_deg))
        wins = min(wins, float((off[best][apart] < off[i][apart]).mean()))
    return ranked[best], _share(first, other, within_deg), following, wins


def detect_positions(
    raw: npt.NDArray[np.floating], rays: npt.NDArray[np.floating], *, stated: Float64 | None = None, role: str = "truth"
) -> AxesReading:
    """Whose axes points `raw` (H, W, 3) have, from the rays (H, W, 2) of the camera that saw them.

    stated : the axes by the user's word; they are held against the rays all the same.
    """
    points, r = _pairs(raw, rays)
    if points.shape[0] < 100:
        raise PassError(f"{role}'s P is known at hardly a pixel that has a ray")
    way = _unit(scene_rays(r))
    if stated is not None:
        share = _share(_unit(points) @ stated.T, way, RAY_DEG)
        axes = Axes(matrix=stated)
        told = f"{role}'s P has {axes.words()} as stated: {100 * share:.0f} % of its points lie on their rays"
        return AxesReading(axes=axes, sure=True, words=told + ("" if share > LEAST_FIT else "; that does not look right"), share=share)
    matrix, share, following, _ = _best_axes(_unit(points), way, RAY_DEG)
    axes = Axes(matrix=matrix)
    if share >= LEAST_FIT and share > CLEAR * following:
        told = f"{role}'s P has {axes.words()}: {100 * share:.0f} % of its points lie on their rays, against {100 * following:.0f} % by other axes"
        return AxesReading(axes=axes, sure=True, words=told, share=share, next_share=following)
    placed, of_world, wrong = _resection(points, r)
    if placed is not None and of_world >= WORLD_FIT:
        told = f"{role}'s P has {placed.words()}: {100 * of_world:.0f} % of its points lie on their rays"
        told += f", against {100 * share:.0f} % as of the camera"
        return AxesReading(axes=placed, sure=True, words=told, share=of_world, next_share=share)
    doubt = (
        f"{role}'s P: only {100 * share:.0f} % of its points lie on the camera's rays by any axes of the camera, and {wrong}. "
        "Give the camera that rendered it with --rig or --fov-deg, or state --axes"
    )
    return AxesReading(axes=axes, sure=False, words=doubt, doubt=doubt, share=share, next_share=following)


def _resection(points: Float64, rays: Float64) -> tuple[Axes | None, float, str]:
    """The camera's place in the world of `points` (n, 3), from their rays (n, 2); the share that fits; why not, where not."""
    centre = np.median(points, axis=0)
    size = float(np.median(np.linalg.norm(points - centre, axis=-1))) or 1.0
    p = (points - centre) / size
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[2] < FLAT * spread[0]:
        return None, 0.0, "they all lie in one plane, which cannot place a camera"
    q = np.concatenate([p, np.ones((p.shape[0], 1))], axis=-1)
    zero = np.zeros_like(q)
    x, y = rays[:, :1], rays[:, 1:]
    rows = np.stack([np.concatenate([q, zero, -x * q], axis=-1), np.concatenate([zero, q, -y * q], axis=-1)], axis=1)
    weight = np.ones(p.shape[0])
    A = np.eye(3, 4)
    off = weight
    for _ in range(6):
        weighed = (rows * weight[:, None, None]).reshape(-1, 12)
        _, _, vt = np.linalg.svd(weighed.T @ weighed)
        A = vt[-1].reshape(3, 4)
        at = q @ A.T
        A = A if np.median(at[:, 2]) > 0 else -A
        at = q @ A.T
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.nan_to_num(np.linalg.norm(at[:, :2] / at[:, 2:] - rays, axis=-1), nan=1e3, posinf=1e3)
        weight = 1 / (np.maximum(np.abs(at[:, 2]), 1e-6) * np.sqrt(1 + (off / max(2 * float(np.median(off)), 1e-9)) ** 2))
    share = float((np.degrees(off) <= RAY_DEG).mean())
    u, s, vt = np.linalg.svd(A[:, :3])
    if s[2] < (1 - RIGID) * s[0]:
        return None, share, "they fit no camera of this focal length that stands elsewhere"
    flip = np.diag([1.0, -1.0, -1.0])  # camera frame to scene frame
    rotation = flip @ (u @ vt)
    shift = flip @ A[:, 3] * size / float(s.mean()) - rotation @ centre
    return Axes(matrix=rotation, shift=shift), share, "no camera that stands elsewhere fits them either"


def detect_normals(
    raw: npt.NDArray[np.floating],
    reference: npt.NDArray[np.floating],
    *,
    stated: Float64 | None = None,
    world: Float64 | None = None,
    coded: bool | None = None,
    exact: bool = False,
    source: str = "the result",
    role: str = "truth",
) -> AxesReading:
    """Whose axes normals `raw` (H, W, 3) have, from normals of the same plate in the scene frame of the camera.

    stated : the axes by the user's word.   world : the rotation from a world that P or a pose gave, tried before one is fitted.
    coded  : whether they are 0..1, by the user's word.
    exact  : the reference comes with the same file, so that a rotation fitted to it may be believed.
    """
    found = coding_of(raw) if coded is None else coded
    if found is None:
        raise PassError(f"{role}'s N is no unit vector at most pixels, neither as it is nor as 0..1 for -1..1; name its channels with --layer")
    v, other = _pairs(raw, reference)
    v = _unit(2 * v - 1 if found else v)
    other = _unit(other)
    if v.shape[0] < 100:
        raise PassError(f"{role}'s N and {source}'s have hardly a known pixel in common; do they belong to the same frame and eye?")
    if stated is not None:
        share = _share(v @ stated.T, other, NORMAL_DEG)
        axes = Axes(matrix=stated, coded=found)
        told = f"{role}'s N has {axes.words()} as stated: {100 * share:.0f} % fit {source} within {NORMAL_DEG:g} degrees"
        return AxesReading(axes=axes, sure=True, words=told, share=share)
    matrix, share, following, wins = _best_axes(v, other, NORMAL_DEG)
    one_way = np.linalg.svd(other.T @ v, compute_uv=False)[1] < ONE_WAY * v.shape[0]
    axes = Axes(matrix=matrix, coded=found)
    turned = _kabsch(v, other) if world is None else world
    of_world = _share(v @ turned.T, other, NORMAL_DEG)
    of_camera = _angle_deg(turned, matrix) < 3
    if not of_camera and not (one_way and world is None) and of_world > max(LEAST_FIT / 2, CLEAR * share):
        axes = Axes(matrix=turned, coded=found)
        told = f"{role}'s N has {axes.words()}: {100 * of_world:.0f} % fit {source} within {NORMAL_DEG:g} degrees"
        told += f", against {100 * share:.0f} % as of the camera"
        if exact or world is not None:
            return AxesReading(axes=axes, sure=True, words=told, share=of_world, next_share=share)
        doubt = f"{told}. The camera's turn would have to be taken from what is judged: give --poses, or a truth that holds P or Z too"
        return AxesReading(axes=axes, sure=False, words=told, doubt=doubt, share=of_world, next_share=share)
    told = f"{role}'s N has {axes.words()}: {100 * share:.0f} % fit {source} within {NORMAL_DEG:g} degrees"
    told += f", against {100 * following:.0f} % by other axes"
    sure = share >= LEAST_FIT / 2 and wins >= WINS and (not one_way or " ".join(axis_words(matrix) or ()) in COMMON)
    doubt = "" if sure else f"{told}. That is too little to tell: state --axes, such as right,up,back"
    return AxesReading(axes=axes, sure=sure, words=told, doubt=doubt, share=share, next_share=following)


def _angle_deg(a: Float64, b: Float64) -> float:
    """The angle of the rotation between two orthogonal matrices; 180 where one of them mirrors."""
    turn = a.T @ b
    if np.linalg.det(turn) < 0:
        return 180.0
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def _kabsch(v: Float64, other: Float64) -> Float64:
    """The orthogonal matrix that takes `v` to `other` best, with weights that let outliers go (Cauchy, at 5 degrees)."""
    weight = np.ones(v.shape[0])
    matrix = np.eye(3)
    for _ in range(10):
        u, _, vt = np.linalg.svd((other * weight[:, None]).T @ v)
        matrix = u @ vt
        off = np.linalg.norm(v @ matrix.T - other, axis=-1)
        weight = 1 / (1 + (off / np.radians(5.0)) ** 2)
    return matrix

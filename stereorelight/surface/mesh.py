"""The seen surface as triangles: one sheet, cut at depth edges, and closed behind by a choice where no camera saw.

In: Z (H, W), metres along the optical axis, and the camera of the plate that Z lies on.  Out: a `Mesh`, scene frame, metres.
A vertex is a pixel's centre; where a neighbour lies on another surface, a pixel reaches half-way to it along its own slope, so that
a silhouette stands where the pixels change and neither shrinks nor grows things.
Inverse depth is affine along planes for any lens: links are judged, and half-ways laid, in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, Int32, as_float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError
from stereorelight.surface.position import checked_depth, ray_slopes

STEEPEST_DEG = 78.0  # a step between neighbours that lies flatter than this to the eye's ray is a surface, whatever stands about it
LOOK_PX = 3  # how far a steeper one is followed to tell a grazing surface from an edge
LIMB_PX, SAME_LIMB = 4, 0.02  # how far along an outline it is evened out, and by what share of its depth it may change over that
LOOK_RECOVERED_PX = 8  # the same for depth that was matched, whose edges are smeared


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles in the scene frame of the camera.

    vertices  : (n, 3) float32, metres; the first H * W are the pixels' own P, row by row, NaN where unknown and then in no triangle.
    triangles : (m, 3) int32; those of the seen sheet come first, and turn counter-clockwise to the camera.
    seen      : how many triangles are of the seen sheet; the others close it behind.
    pixel     : (n,) the pixel that each vertex belongs to, row by row.
    """

    vertices: Float32
    triangles: Int32
    seen: int
    pixel: npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Links:
    """Which neighbours lie on one surface: `across` (H, W - 1) to the right one, `down` (H - 1, W) to the lower one."""

    across: Bool
    down: Bool

    def beside(self) -> tuple[Bool, Bool, Bool, Bool]:
        """(H, W) each: linked to the left, right, upper, lower neighbour."""
        h, w = self.down.shape[0] + 1, self.across.shape[1] + 1
        left, right, up, low = (np.zeros((h, w), bool) for _ in range(4))
        left[:, 1:] = right[:, :-1] = self.across
        up[1:] = low[:-1] = self.down
        return left, right, up, low


def _linked(w: Float64, sigma: Float64, flat: float, look: int) -> Bool:
    """Links along the last axis of inverse depth w; `flat` is the share of w that a surface may change a pixel anyhow."""
    step = np.diff(w)
    width = w.shape[1]
    with np.errstate(invalid="ignore"):
        noise = np.minimum(np.nan_to_num(np.hypot(sigma[:, 1:], sigma[:, :-1])), flat * w[:, 1:])
        linked: Bool = np.abs(step) <= flat * np.minimum(w[:, 1:], w[:, :-1]) + noise
        for side in (-1, 1):  # the slope before the step, and the one behind it
            slope = np.full_like(step, np.nan)
            if width > look + 1:
                far = (w[:, look:] - w[:, :-look]) / look
                # Both the next step and the whole way must tell of the slope: the whole way alone may lead over another edge.
                if side < 0:
                    slope[:, look:] = _smaller(far[:, :-1], step[:, look - 1 : -1])
                else:
                    slope[:, :-look] = _smaller(far[:, 1:], step[:, 1 : width - look])
            linked |= np.abs(step - slope) <= np.abs(slope) + noise
    return linked


def _smaller(a: Float64, b: Float64) -> Float64:
    """The one nearer to 0 where both have the same sign, else 0."""
    return np.where(a * b > 0, np.where(np.abs(a) < np.abs(b), a, b), 0.0)


def links_of(Z: npt.ArrayLike, camera: Camera, *, Z_sigma: npt.ArrayLike | None = None) -> Links:
    """Which neighbouring pixels of a depth lie on one surface.

    A step is an edge where it is steeper than STEEPEST_DEG against the eye's ray and neither side's own slope leads over it: a floor seen at a
    grazing angle and the limb of a ball hang together, a nose before a wall does not.  Z_sigma, (H, W) metres, widens what is allowed.
    """
    depth = checked_depth(Z, camera).astype(np.float64)
    sigma = np.zeros_like(depth) if Z_sigma is None else as_float32(Z_sigma, "Z_sigma", size_hw=camera.size_hw) / depth**2
    w = 1 / depth
    steep = math.tan(math.radians(STEEPEST_DEG))
    look = LOOK_PX if Z_sigma is None else LOOK_RECOVERED_PX
    return Links(across=_linked(w, sigma, steep / camera.fx, look), down=_linked(w.T, sigma.T, steep / camera.fy, look).T)


def solid(links: Links) -> Bool:
    """(H, W) bool: the pixels of some 3 x 3 patch that hangs together.

    Matching cannot find what is narrower, but leaves specks and threads at depth edges, which would cast streaks."""
    h, w = links.down.shape[0] + 1, links.across.shape[1] + 1
    whole = links.across[:-1] & links.across[1:] & links.down[:, :-1] & links.down[:, 1:]
    patch = whole[:-1, :-1] & whole[:-1, 1:] & whole[1:, :-1] & whole[1:, 1:]
    held = np.zeros((h, w), bool)
    for dy in range(3):
        for dx in range(3):
            held[dy : h - 2 + dy, dx : w - 2 + dx] |= patch
    return held


def beside_nearer(Z: Float32, links: Links, *, within_px: int) -> Bool:
    """(H, W) bool: pixels within so many steps of an edge, on its farther side.

    Matching bends the ground up to whatever stands before it: true enough for light, but no caster of shadows."""
    seeds = np.zeros(Z.shape, bool)
    with np.errstate(invalid="ignore"):
        seeds[:, 1:] |= ~links.across & (Z[:, 1:] > Z[:, :-1])
        seeds[:, :-1] |= ~links.across & (Z[:, :-1] > Z[:, 1:])
        seeds[1:] |= ~links.down & (Z[1:] > Z[:-1])
        seeds[:-1] |= ~links.down & (Z[:-1] > Z[1:])
    left, right, up, low = links.beside()
    for _ in range(within_px):
        grown = seeds.copy()
        grown[:, 1:] |= seeds[:, :-1] & left[:, 1:]
        grown[:, :-1] |= seeds[:, 1:] & right[:, :-1]
        grown[1:] |= seeds[:-1] & up[1:]
        grown[:-1] |= seeds[1:] & low[:-1]
        seeds = grown
    return seeds


def without(links: Links, gone: Bool) -> Links:
    """The links that are left where some pixels are taken out."""
    return Links(across=links.across & ~gone[:, 1:] & ~gone[:, :-1], down=links.down & ~gone[1:] & ~gone[:-1])


def half_steps(w: Float64, links: Links) -> tuple[Float64, Float64, Float64, Float64]:
    """(H, W) each: what inverse depth changes by from a pixel's centre to its left, right, upper and lower side.

    Half-way to a linked neighbour; beyond an edge along the slope from the other side, as far as there is one."""
    linked = links.beside()
    steps = []
    for axis, shift in ((1, 1), (1, -1), (0, 1), (0, -1)):
        with np.errstate(invalid="ignore"):
            steps.append((np.roll(w, shift, axis=axis) - w) / 2)
    halves = []
    for side, other in ((0, 1), (1, 0), (2, 3), (3, 2)):
        away = np.where(linked[other], -steps[other], 0.0)
        halves.append(np.where(linked[side], steps[side], np.clip(away, -0.4 * w, 0.4 * w)))
    return halves[0], halves[1], halves[2], halves[3]


def _limb(w: Float64, half: Float64, side: int, linked: tuple[Bool, Bool, Bool, Bool]) -> Float64:
    """`half` steps to one side, with outlines of round things evened out along themselves.

    A round thing falls off ever faster to its outline, and its last pixels end at any distance from it: their depths jump from row to row,
    and a shadow's edge would be a saw.  Each takes the deepest fall of the outline about it, reckoned from LOOK_PX inside."""
    dy, dx = ((0, 1), (0, -1), (1, 0), (-1, 0))[side]  # inwards
    inner = linked[side ^ 1]
    y, x = np.nonzero(~linked[side] & inner & np.isfinite(w))
    h, width = w.shape
    room = (y + LOOK_PX * dy >= 0) & (y + LOOK_PX * dy < h) & (x + LOOK_PX * dx >= 0) & (x + LOOK_PX * dx < width)
    y, x = y[room], x[room]
    chain = np.ones(len(y), bool)
    for k in range(LOOK_PX):
        chain &= inner[y + k * dy, x + k * dx]
    y, x = y[chain], x[chain]
    base, fall = np.full_like(w, np.nan), np.full_like(w, np.nan)
    base[y, x] = w[y + LOOK_PX * dy, x + LOOK_PX * dx]
    fall[y, x] = w[y, x] + half[y, x] - base[y, x]
    along, across = (LIMB_PX, 1) if dx else (1, LIMB_PX)
    reach = max(along, across)
    bases, falls = (np.pad(a, reach, constant_values=np.nan) for a in (base, fall))
    own, deepest = base[y, x], fall[y, x]
    for oy in range(-along, along + 1):
        for ox in range(-across, across + 1):
            at = (y + reach + oy, x + reach + ox)
            with np.errstate(invalid="ignore"):
                near = np.abs(bases[at] - own) <= SAME_LIMB * own
                deepest = np.where(near, np.fmin(deepest, falls[at]), deepest)
    out = half.copy()
    out[y, x] = np.maximum(own + deepest - w[y, x], -0.4 * w[y, x])
    return out


def _place(slopes: Float64, w: Float64) -> Float32:
    """Scene-frame points (..., 3) at inverse depth w along rays of the given slopes."""
    return np.stack([slopes[..., 0] / w, -slopes[..., 1] / w, -1 / w], axis=-1).astype(np.float32)


def mesh_from_depth(
    Z: npt.ArrayLike,
    camera: Camera,
    *,
    Z_sigma: npt.ArrayLike | None = None,
    thickness_m: float | npt.ArrayLike = 0.0,
    links: Links | None = None,
) -> Mesh:
    """The surface that a depth shows.

    Z           : (H, W), metres along the optical axis; NaN where unknown.
    Z_sigma     : (H, W), metres; widens what hangs together.
    thickness_m : how far behind it a thing goes on along the eye's ray: a number, or (H, W).  0 is a sheet, open behind.
    links       : as `links_of` finds them, where they are known.
    Raises      : PassError where no pixel is known, and for arrays that do not fit.
    """
    depth = checked_depth(Z, camera).astype(np.float64)
    h, w = depth.shape
    slopes = ray_slopes(camera)
    depth = np.where(np.isnan(slopes[..., 0]), np.nan, depth)
    known = np.isfinite(depth)
    if not known.any():
        raise PassError("the surface has no known pixel: Z is NaN everywhere; recover depth first, or check its layer")
    inverse = 1 / depth
    linked = links or links_of(Z, camera, Z_sigma=Z_sigma)
    thick = np.broadcast_to(np.asarray(thickness_m, dtype=np.float64), (h, w))
    if not np.nanmin(thick) >= 0:
        raise PassError(f"thickness must be >= 0 metres, got {float(np.nanmin(thick)):g}; 0 is a thin sheet")
    centres = _place(slopes, inverse).reshape(-1, 3)
    if h < 2 or w < 2:
        return Mesh(vertices=centres, triangles=np.empty((0, 3), np.int32), seen=0, pixel=np.arange(h * w))
    whole = linked.across[:-1] & linked.across[1:] & linked.down[:, :-1] & linked.down[:, 1:]
    y, x = np.nonzero(whole)
    tl = (y * w + x).astype(np.int32)
    tr, bl, br = tl + np.int32(1), tl + np.int32(w), tl + np.int32(w + 1)
    flat = inverse.reshape(-1)
    falling = (np.abs(flat[tl] - flat[br]) <= np.abs(flat[tr] - flat[bl]))[:, None]  # split along the flatter diagonal
    first = np.where(falling, np.stack([tl, bl, br], -1), np.stack([tl, bl, tr], -1))
    second = np.where(falling, np.stack([tl, br, tr], -1), np.stack([tr, bl, br], -1))
    rim = _Rim(inverse, slopes, linked, whole, h * w)
    sheet = np.concatenate([first, second, rim.triangles])
    vertices = np.concatenate([centres, _place(rim.slopes, rim.inverse)])
    pixel = np.concatenate([np.arange(h * w), rim.pixel])
    if not thick.any():
        return Mesh(vertices=vertices, triangles=sheet, seen=len(sheet), pixel=pixel)
    back = 1 / (1 / np.concatenate([flat, rim.inverse]) + np.nan_to_num(thick.reshape(-1))[pixel])
    behind = _place(np.concatenate([slopes.reshape(-1, 2), rim.slopes]), back)
    shift = np.int32(len(vertices))
    a, b = rim.outer[:, 0], rim.outer[:, 1]
    walls = np.concatenate([np.stack([b, a, a + shift], -1), np.stack([b, a + shift, b + shift], -1)])
    triangles = np.concatenate([sheet, sheet[:, ::-1] + shift, walls])
    return Mesh(vertices=np.concatenate([vertices, behind]), triangles=triangles, seen=len(sheet), pixel=np.concatenate([pixel, pixel]))


class _Rim:
    """The quarters of pixels in every 2x2 block that an edge runs through: their vertices, triangles, and outer sides."""

    def __init__(self, inverse: Float64, slopes: Float64, links: Links, whole: Bool, first: int) -> None:
        w = inverse.shape[1]
        known = np.isfinite(inverse)
        any_known = known[:-1, :-1] | known[:-1, 1:] | known[1:, :-1] | known[1:, 1:]
        y, x = np.nonzero(any_known & ~whole)
        corners = [(y, x), (y, x + 1), (y + 1, x), (y + 1, x + 1)]
        beside_ = links.beside()
        left, right, up, low = (_limb(inverse, half, side, beside_) for side, half in enumerate(half_steps(inverse, links)))
        linked = [links.across[y, x], links.across[y + 1, x], links.down[y, x], links.down[y, x + 1]]  # top, bottom, left, right
        pairs = [(0, 1), (2, 3), (0, 2), (1, 3)]
        # Pixels of a block that hang together share its corner, so that their quarters close.
        label = np.tile(np.arange(4), (len(y), 1))
        for _ in range(3):
            for (a, b), on in zip(pairs, linked):
                least = np.minimum(label[:, a], label[:, b])
                label[:, a] = np.where(on, least, label[:, a])
                label[:, b] = np.where(on, least, label[:, b])
        beside = [right, left, right, left]
        above = [low, low, up, up]
        own = np.stack([inverse[at] + beside[k][at] + above[k][at] for k, at in enumerate(corners)], -1)
        middle = np.mean([slopes[at] for at in corners], axis=0)
        corner = np.empty_like(own)
        size = np.empty(own.shape, np.int64)
        ends = {name: np.full(own.shape, -1, np.int32) for name in ("side", "foot", "corner")}
        for k in range(4):
            same = (label == label[:, k : k + 1]) & np.isfinite(own)
            corner[:, k] = np.where(same, np.nan_to_num(own), 0).sum(-1) / np.maximum(same.sum(-1), 1)
            size[:, k] = same.sum(-1)
        across_of, down_of = [1, 0, 3, 2], [2, 3, 0, 1]  # the neighbour in the block along the row, along the column
        cut_across = [~linked[0], ~linked[0], ~linked[1], ~linked[1]]
        cut_down = [~linked[2], ~linked[3], ~linked[2], ~linked[3]]
        turns = [False, True, True, False]  # quarters whose corners come the other way round
        made_w: list[Float64] = []
        made_slopes: list[Float64] = []
        pixels: list[npt.NDArray[np.int64]] = []
        triangles: list[Int32] = []
        outer: list[Int32] = []
        count = first
        for k, at in enumerate(corners):
            there = known[at] & np.isfinite(slopes[corners[across_of[k]]][:, 0] + slopes[corners[down_of[k]]][:, 0] + middle[:, 0])
            n = int(there.sum())
            here = (at[0][there], at[1][there])
            pixel = here[0] * w + here[1]
            side = (slopes[here] + slopes[corners[across_of[k]]][there]) / 2
            foot = (slopes[here] + slopes[corners[down_of[k]]][there]) / 2
            made_slopes += [side, foot, middle[there]]
            made_w += [inverse[here] + beside[k][here], inverse[here] + above[k][here], corner[there, k]]
            pixels += [pixel, pixel, pixel]
            ids = np.arange(n, dtype=np.int32) + np.int32(count)
            s, f, c, p = ids, ids + np.int32(n), ids + np.int32(2 * n), pixel.astype(np.int32)
            lone = size[there, k] == 1  # a pixel alone in its block gives up its corner, so that slanting outlines are no stairs
            quarter = [np.stack([p, f, c], -1)[~lone], np.stack([p, c, s], -1)[~lone], np.stack([p, f, s], -1)[lone]]
            triangles += [t[:, ::-1] if turns[k] else t for t in quarter]
            edges = ((cut_across[k][there] & ~lone, np.stack([c, s], -1)), (cut_down[k][there] & ~lone, np.stack([f, c], -1)))
            sides = [edge[cut] for cut, edge in (*edges, (lone, np.stack([f, s], -1)))]
            outer += [side[:, ::-1] if turns[k] else side for side in sides]  # as the quarters' own triangles run along them
            for name, made in (("side", s), ("foot", f), ("corner", c)):
                ends[name][there, k] = made
            count += 3 * n
        for k in range(4):  # ... and three that hang together take the corner that the fourth gave up
            beyond = np.stack([ends["corner"][:, across_of[k]], ends["side"][:, across_of[k]], ends["foot"][:, down_of[k]]], -1)
            three = beyond[(size[:, across_of[k]] == 3) & (size[:, k] != 3) & (beyond >= 0).all(axis=-1)]
            triangles.append(three if not turns[k] else three[:, ::-1])
        self.inverse = np.concatenate(made_w) if made_w else np.empty(0)
        self.slopes = np.concatenate(made_slopes) if made_slopes else np.empty((0, 2))
        self.pixel = np.concatenate(pixels) if pixels else np.empty(0, np.int64)
        self.triangles = np.concatenate(triangles) if triangles else np.empty((0, 3), np.int32)
        self.outer = np.concatenate(outer) if outer else np.empty((0, 2), np.int32)

"""Fits what depth says of itself: confidence and `disparity_sigma` (stereo/confidence.py) and `N_sigma` (surface/normals.py).

Run:  python tests/benchmarks/fit_confidence.py [--cache DIR] [--pixels N] [--check]
In: pairs with exact answers of four families: rendered SCENES, clean and with GRAINS of full range on gamma-coded plates; photographs on planes
and balls under grain of linear light (bench_grain.py); bare ROOMS (bench_plain_rooms.py); and plain things between strong rims, blurred and
compressed (tests/plain_scenes.py).  N pixels of each pair, drawn at random.  Out, printed: the three sets of coefficients, ready to be put into those
modules; how true they are on the pairs of the fit; how true on each family when it is left out; and on those that have no part in it
(HELD_OUT, OTHER_ROOMS, other photographs, Motorcycle and, where STEREORELIGHT_DATA holds them, real boards).  --check fits nothing and judges the
coefficients that stand.  --draft does the same for what a draft's half-size pictures say of themselves, confidence alone; drafts that are matched
as other pictures are have no part in the fit, and are judged by the coefficients of those.

Confidence: the likelihood of being within 1 px of truth, floors and all, with a ridge.  Standard deviations: regression of the 0.683 quantile
of the logarithm of the error (Koenker and Bassett 1978) where both eyes see, since 68 % of the errors are to be within what is told; few bad
ones have no say.  `N_sigma` is fitted on rendered pairs alone, and takes its share of facing as geometry has it.  One after the other: each
rests on the one before it."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.camera import RectifiedRig
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.compare.normals import angle_deg
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo import confidence as belief
from stereorelight.stereo.depth import half_settings, matched, refined_with_evidence
from stereorelight.stereo.draft import full_size
from stereorelight.stereo.flow import flow_disparity
from stereorelight.stereo.halves import half_rig, half_view, nearest
from stereorelight.stereo.proxy import matching_proxy, picture_of
from stereorelight.stereo.rectify import Rectification, rectification
from stereorelight.stereo.search import search_range
from stereorelight.stereo.settings import DepthSettings
from stereorelight.surface import normals as surface
from stereorelight.surface.normals import normals_from_depth
from stereorelight.surface.position import ray_slopes
from stereorelight.synth.rigs import parallel_rig
from stereorelight.threads import set_threads
from tests import plain_scenes
from tests.benchmarks import bench_grain, bench_plain_rooms
from tests.benchmarks.bench_depth import linear, pair_of_plates
from tests.benchmarks.bench_depth_scenes import grained, rendered

SCENES = ("bust", "weak", "thin", "table", "statue", "interior", "sphere")
HELD_OUT = ("repeat", "two_planes", "box")
SIZES = ((640, 360),)
GRAINS = (0.0, 0.01, 0.02)
PHOTOGRAPHS, OTHER_PHOTOGRAPHS = range(1, 7), range(10, 14)
PHOTOGRAPHED = (("clean", 1.0), ("add", 1.0), ("add", 0.25), ("both", 1.0), ("photon", 0.25))  # grain, and exposure
OTHERWISE_PHOTOGRAPHED = (("clean", 1.0), ("add", 1.0), ("add", 0.25), ("photon", 1.0), ("photon", 0.25), ("both", 1.0), ("both", 0.25))
ROOMS, OTHER_ROOMS, CONTRASTS = ("bust", "box", "sphere"), ("interior", "two_planes", "statue"), (0.01, 0.02, 0.04)
PLAIN = (*range(14), *range(plain_scenes.FILLED, plain_scenes.FILLED + 10), *range(plain_scenes.LARGE, plain_scenes.LARGE + 30))
WORTH = {"rendered": 4.0, "plain": 0.25}  # of a family beside the others: made-up boards are barer and worse compressed than what is shot
# What only plain ground teaches, as a fit in which families counted alike had it, but half of what texture was worth there.
KEPT = {"log texture": 0.15, "on rims": 2.35}
FOR = {"confirmed", "flow agrees", "confirmed nearby", "flow agrees nearby", "log texture", "on rims", "log led"}  # never makes less sure
AGAINST = {"edge nearby", "log sigma", "log misfit", "eyes share nothing", "log uneven", "log lost"}  # never makes surer
AT_MOST = {"eyes share nothing": -0.6}  # grain that matches grain counts, however little that has to say beside the rest
WITHIN = 0.683
RIDGE = 1e-4  # on coefficients, per pixel: keeps those that say the same from running off against each other
CLIP = 1e-4  # least error, px and degrees: nothing is told finer


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """A pair as the judge sees it, every array (H, W) but normals, and which pixels are judged."""

    name: str
    family: str
    rig: RectifiedRig
    disparity: np.ndarray
    evidence: belief.Evidence
    error: np.ndarray
    N: np.ndarray
    seen: np.ndarray
    drawn: np.ndarray
    floors: tuple[float, float, float]
    own: bool  # judged by the coefficients that are fitted, and not, as a draft that was matched as other pictures are, by theirs


def looked_at(
    name: str,
    plates: Sequence[np.ndarray],
    rectified: Rectification,
    truth: np.ndarray,
    N: np.ndarray | None,
    seen: np.ndarray,
    pixels: int,
    *,
    near_m: float | None = None,
    far_m: float | None = None,
    draft: bool = False,
) -> Pair:
    """N None: normals are not judged.   name: its first word is the pair's family."""
    views = [rectified.rectify(plate, eye, to_match=True) for plate, eye in zip(plates, ("left", "right"), strict=True)]
    if draft:
        disparity, evidence = _drafted(views, rectified, near_m, far_m)
    else:
        proxy = matching_proxy(*views, steps=(rectified.step("left"), rectified.step("right")))
        search = search_range(proxy, rectified.rig, near_m=near_m, far_m=far_m)
        refined, _, evidence = refined_with_evidence(proxy, matched(proxy, search, DepthSettings()), DepthSettings(), flow_disparity(proxy))
        disparity = refined.disparity
    known = np.flatnonzero(np.isfinite(truth))
    drawn = np.random.default_rng(0).choice(known, min(pixels, known.size), replace=False)
    error = np.abs(disparity - truth)
    N = np.full((*truth.shape, 3), np.nan, np.float32) if N is None else N
    family = name.split()[0]
    floors = belief.of_drafts(evidence)[1] if draft else belief.FLOORS
    own = not draft or evidence.led is None
    judged = {"disparity": disparity, "evidence": evidence, "error": error, "N": N, "seen": seen, "drawn": drawn}
    return Pair(name=name, family=family, rig=rectified.rig, floors=floors, own=own, **judged)


def _drafted(views: Sequence[np.ndarray], rectified: Rectification, near_m: float | None, far_m: float | None) -> tuple[np.ndarray, belief.Evidence]:
    """The disparity of a draft, and its evidence on the pixels that it comes from, in pixels of the plate."""
    proxy = matching_proxy(*(half_view(view) for view in views), even=False)
    search = search_range(proxy, half_rig(rectified.rig), near_m=near_m, far_m=far_m)
    settings = half_settings(DepthSettings(quality="draft"))
    refined, _, evidence = refined_with_evidence(proxy, matched(proxy, search, settings), settings, None)
    full = full_size(refined, picture_of(views[0], "left"))
    size = (full.disparity.shape[0], full.disparity.shape[1])
    told = {name: a if not isinstance(a, np.ndarray) else nearest(a, size) for name, a in vars(evidence.in_pixels(2)).items()}
    return full.disparity, belief.Evidence(**told)


def of_scenes(
    names: Sequence[str], sizes: Sequence[tuple[int, int]], grains: Sequence[float], pixels: int, cache: Path | None, *, draft: bool = False
) -> Iterator[Pair]:
    for size in sizes:
        rectified = rectification(parallel_rig(size))
        per = rectified.rig.left.fx * rectified.rig.baseline_m
        for name in names:
            made = rendered(name, size, cache)
            for grain in grains:
                rng = np.random.default_rng(1)
                plates = [grained(made[eye], grain, rng) for eye in ("left", "right")]
                told = f"rendered {name} {size[0]}x{size[1]} {100 * grain:.0f} %"
                yield looked_at(told, plates, rectified, per / made["Z"], made["N"], made["flags"] == 0, pixels, draft=draft)


def of_motorcycle(grains: Sequence[float], pixels: int, *, draft: bool = False) -> Iterator[Pair]:
    left, right, rectified = pair_of_plates()
    pair, per = motorcycle(), rectified.rig.left.fx * rectified.rig.baseline_m
    truth = np.where(np.isfinite(pair.disparity), pair.disparity, np.nan).astype(np.float32)
    Z = (per / (truth + rectified.rig.doffs_px)).astype(np.float32)
    N = normals_from_depth(Z, rectified.rig.left, noise_per_m=0.1 / per)  # the scanned truth is rough by itself
    for grain in grains:
        rng = np.random.default_rng(7)
        plates = [grained(p, grain, rng) if grain else p for p in (left, right)]
        yield looked_at(f"motorcycle {100 * grain:.0f} %", plates, rectified, truth, N, pair.nonoccluded, pixels, draft=draft)


def of_photographs(numbers: Sequence[int], kinds: Sequence[tuple[str, float]], pixels: int, *, draft: bool = False) -> Iterator[Pair]:
    rectified = rectification(parallel_rig((bench_grain.W, bench_grain.H)))
    per = rectified.rig.left.fx * rectified.rig.baseline_m
    reach = {"near_m": per / bench_grain.NEAREST_PX, "far_m": per / bench_grain.FARTHEST_PX}
    for number in numbers:
        left, right, disparity, seen = bench_grain.rendered(number)
        truth = np.where(seen, disparity, np.nan)
        for kind, exposure in kinds:
            floor, shot = bench_grain.GRAIN[kind]
            rng = np.random.default_rng(1000 * number + 7)
            plates = []
            for light in (exposure * left, exposure * right):
                plates.append((light + np.sqrt(np.maximum(floor + shot * light, 0)) * rng.standard_normal(light.shape)).astype(np.float32))
            yield looked_at(f"photographs {number} {kind} x {exposure:g}", plates, rectified, truth, None, seen, pixels, **reach, draft=draft)


def of_rooms(names: Sequence[str], pixels: int, cache: Path | None, *, draft: bool = False) -> Iterator[Pair]:
    rectified = bench_plain_rooms.rig_of()
    for room in bench_plain_rooms.rooms(names, CONTRASTS, cache=cache):
        yield looked_at(f"rooms {room.name}", room.plates, rectified, room.truth, room.N, room.seen, pixels, draft=draft)


def of_plain(numbers: Sequence[int], pixels: int, *, draft: bool = False) -> Iterator[Pair]:
    rectified = rectification(parallel_rig((plain_scenes.W, plain_scenes.H)))
    for number in numbers:
        left, right, disparity, seen = plain_scenes.plain_pair(number)
        yield looked_at(f"plain {number}", (left, right), rectified, disparity, None, seen, pixels, draft=draft)


def of_real_boards(pixels: int, *, draft: bool = False) -> Iterator[Pair]:
    """Every pixel of the thirteen real boards; nothing where they are not at hand."""
    from stereorelight.calibration.lens_choice import choose
    from tests.benchmarks.bench_real_boards import FOLDER, plane_of, real_views

    if not FOLDER.is_dir():
        return
    _, calibration = choose(real_views(), ((640, 480), (640, 480)))
    rectified = rectification(calibration.rig)
    for pose, name in zip(calibration.board_poses, calibration.views.names, strict=True):
        plates = [linear(cv2.imread(str(FOLDER / f"{eye}{name}.jpg"))) for eye in ("left", "right")]
        shown, plane = plane_of(pose, calibration.board_m, rectified)
        yield looked_at(f"board {name}", plates, rectified, np.where(shown, plane, np.nan), None, shown, pixels, draft=draft)


def confidence_evidence(e: belief.Evidence) -> np.ndarray:
    """(H W, 18) in the order of `belief.EVIDENCE`."""
    log_led = np.log(0.1 + (np.ones_like(e.sigma) if e.led is None else e.led))
    edge = np.minimum(e.spread, 6) / 6
    log_sigma = np.log(np.maximum(e.sigma, 1e-3) / 0.03) - belief.USUAL_SHARE * np.log(e.usual)
    columns = (
        np.ones_like(edge), e.confirmed, e.flow_agrees, edge, log_sigma, e.confirmed_nearby, e.flow_agrees_nearby,
        edge * e.confirmed_nearby, edge * e.flow_agrees_nearby, np.log(1 + e.misfit / e.usual), e.alone, np.log(0.1 + e.texture),
        np.log(0.02 + e.uneven),
        np.full_like(edge, np.log(belief.LEAST_LOST + e.lost)), np.zeros_like(edge) if e.on_rims is None else e.on_rims,
        log_led, np.zeros_like(edge) if e.on_walls is None else e.on_walls, e.confirmed_nearby * log_led,
    )  # fmt: skip
    return np.stack([c.ravel() for c in columns], axis=1).astype(np.float64)


def sigma_evidence(e: belief.Evidence, confidence: np.ndarray) -> np.ndarray:
    clumped = np.maximum(e.clumped, belief.LEAST_CLUMPED) / belief.USUALLY_CLUMPED
    missing = e.alone * np.maximum(belief.SURE - confidence, 0)
    columns = (np.ones_like(confidence), np.log(np.maximum(e.sigma, 1e-3) / 0.03), np.log((1.005 - confidence) / 0.02), np.log(clumped), missing)
    return np.stack([c.ravel() for c in columns], axis=1).astype(np.float64)


def fitted_confidence(A: np.ndarray, floor2: np.ndarray, right: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The coefficients.   floor2 : square of the floor of each pixel."""
    scale = 1 + floor2
    still = np.arange(A.shape[1]) > 0  # the constant is free

    def loss(c: np.ndarray) -> tuple[float, np.ndarray]:
        p = 1 / (1 + np.exp(-np.clip(A @ c, -30, 30)))
        told = np.clip(np.sqrt((p * p + floor2) / scale), 1e-6, 1 - 1e-6)
        value = -(weight * (right * np.log(told) + (1 - right) * np.log(1 - told))).sum()
        by_told = -weight * (right / told - (1 - right) / (1 - told))
        by_c = A.T @ (by_told * p / (scale * told) * p * (1 - p))
        return value + RIDGE * (c[still] ** 2).sum(), by_c + 2 * RIDGE * c * still

    def bounds(name: str) -> tuple[float | None, float | None]:
        if name in KEPT:
            return KEPT[name], KEPT[name]
        return (0.0 if name in FOR else None), AT_MOST.get(name, 0.0 if name in AGAINST else None)

    limits = [bounds(name) for name in belief.EVIDENCE]
    start = np.array([KEPT.get(name, AT_MOST.get(name, 0.0)) for name in belief.EVIDENCE])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=limits, options={"maxiter": 2000})
    print(f"confidence: log loss {found.fun:.5f}", flush=True)
    return found.x


def fitted_quantile(A: np.ndarray, log_error: np.ndarray, weight: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Coefficients c such that a share `WITHIN` of log_error is below A c; the corner of the loss is rounded a little."""
    soft = 0.05

    def loss(c: np.ndarray) -> tuple[float, np.ndarray]:
        u = log_error - A @ c
        value = weight * (WITHIN * u + soft * np.logaddexp(0, -u / soft))
        return value.sum(), -A.T @ (weight * (WITHIN - 1 / (1 + np.exp(np.clip(u / soft, -60, 60)))))

    return minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000}).x


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    confidence: np.ndarray
    sigma: tuple[float, ...]
    normals: tuple[float, ...]


def told_of(pair: Pair, c: Coefficients) -> tuple[np.ndarray, np.ndarray]:
    own = c.confidence if pair.own else belief.COEFFICIENTS
    sure = belief.confidence_from_evidence(pair.evidence, own.astype(np.float32), pair.floors)
    return sure, belief.sigma_from_evidence(pair.evidence, sure, c.sigma)


def normals_evidence(pair: Pair, c: Coefficients) -> tuple[np.ndarray, np.ndarray]:
    """(H W, 5) what `surface.FITTED` weighs, and the angle to truth, degrees; NaN where either is unknown or the other eye sees nothing."""
    sure, sigma = told_of(pair, c)
    camera, per = pair.rig.left, pair.rig.left.fx * pair.rig.baseline_m
    off = pair.disparity.astype(np.float64) + pair.rig.doffs_px
    rays = ray_slopes(camera)
    N, error, radius = surface._by_planes(off / per, rays, sure, surface.RADII_PX, MATCH_NOISE_PX / per)
    columns = surface.what_normals_know(N, error, radius, (camera.fx * sigma / off).astype(np.float32), rays)
    A = np.stack([np.ones(N.shape[:2]), *columns], axis=-1).reshape(-1, len(columns) + 1)
    return A, np.where(pair.seen, angle_deg(N, pair.N), np.nan).ravel()


def weights_of(pairs: Sequence[Pair]) -> np.ndarray:
    """Of each drawn pixel: every family counts what it is `WORTH`, and every pair within it alike."""
    of_family = Counter(p.family for p in pairs)
    worth = {family: WORTH.get(family, 1.0) / count for family, count in of_family.items()}
    return np.concatenate([np.full(p.drawn.size, worth[p.family] / p.drawn.size) for p in pairs]) / len(of_family)


def confidence_of(pairs: Sequence[Pair]) -> np.ndarray:
    floor2 = []
    for p in pairs:
        floor, lower = belief.floors(p.evidence.lost, p.floors)
        floor2.append((floor + p.evidence.alone.ravel()[p.drawn] * (lower - floor)) ** 2)
    A = np.concatenate([confidence_evidence(p.evidence)[p.drawn] for p in pairs])
    error = np.concatenate([p.error.ravel()[p.drawn] for p in pairs])
    return fitted_confidence(A, np.concatenate(floor2), (error <= 1).astype(np.float64), weights_of(pairs))


def fitted(pairs: Sequence[Pair]) -> Coefficients:
    c = Coefficients(confidence=confidence_of(pairs), sigma=belief.SIGMA_COEFFICIENTS, normals=surface.FITTED)
    seen = np.concatenate([p.seen.ravel()[p.drawn] for p in pairs])
    error = np.concatenate([p.error.ravel()[p.drawn] for p in pairs])
    A = np.concatenate([sigma_evidence(p.evidence, told_of(p, c)[0])[p.drawn] for p in pairs])
    sigma = fitted_quantile(A[seen], np.log(np.maximum(error[seen], CLIP) / 0.03), weights_of(pairs)[seen], np.array(c.sigma))
    c = Coefficients(confidence=c.confidence, sigma=tuple(sigma), normals=c.normals)
    rows, angles, weights = [], [], []
    for p in (p for p in pairs if p.family == "rendered"):
        A, angle = (a[p.drawn] for a in normals_evidence(p, c))
        good = np.isfinite(angle) & np.isfinite(A).all(axis=1)
        if good.any():
            rows.append(A[good]), angles.append(angle[good]), weights.append(np.full(good.sum(), 1 / good.sum()))
    A, angle, weight = np.concatenate(rows), np.concatenate(angles), np.concatenate(weights) / len(weights)
    most = surface.FITTED_MOST_DEG
    log = np.log(-most * np.log1p(-np.clip(angle, CLIP, 0.999 * most) / most))  # what levels off, straightened: quantiles stay quantiles
    free = [0, 1, 2, 4]
    told = fitted_quantile(A[:, free], log - A[:, 3], weight, np.array(surface.FITTED)[free])
    return Coefficients(confidence=c.confidence, sigma=c.sigma, normals=(*told[:3], 1.0, told[3]))


def in_five(error: np.ndarray, told: np.ndarray) -> str:
    """What 68 % of the errors stay within over what is told, in five bins of what is told."""
    if error.size < 100:
        return "-"
    edges = np.quantile(told, np.linspace(0, 1, 6))
    bins = [(told >= low) & (told <= high) for low, high in pairwise(edges)]
    return " ".join(f"{np.quantile(error[one], WITHIN) / told[one].mean():5.2f}" for one in bins)


def judge(heading: str, pairs: Sequence[Pair], c: Coefficients, *, each: bool = False) -> None:
    """How true the coefficients are over `pairs` in one heap: confidence by tenths, and both standard deviations in five bins."""
    heap: list[list[np.ndarray]] = []
    for p in pairs:
        sure, sigma = (a.ravel()[p.drawn] for a in told_of(p, c))
        A, angle = (a[p.drawn] for a in normals_evidence(p, c))
        normal = surface.told_deg(tuple(A[:, 1:].T), c.normals)
        heap.append([p.error.ravel()[p.drawn], sure, sigma, angle, normal, p.seen.ravel()[p.drawn]])
        if each and len(pairs) > 1:
            print(f"  {p.name:26s} " + summary(heap[-1]), flush=True)
    if not heap:
        return
    whole = [np.concatenate(part) for part in zip(*heap, strict=True)]
    print(f"{heading:28s} " + summary(whole))
    error, sure = whole[0], whole[1]
    for low, high in pairwise((0, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.001)):
        one = (sure >= low) & (sure < high)
        if one.mean() > 0.001:
            print(f"    {low:.2f}  {100 * one.mean():5.1f} % of the pixels, told {sure[one].mean():.3f}, right {(error[one] <= 1).mean():.3f}")


def summary(told: Sequence[np.ndarray]) -> str:
    error, sure, sigma, angle, normal, seen = told
    right = error <= 1
    tenths = [(sure >= low) & (sure < low + 0.1) for low in np.arange(0, 1, 0.1)]
    worst = max((abs(sure[t].mean() - right[t].mean()) for t in tenths if t.mean() > 0.01), default=np.nan)
    hidden = f"hidden told {sure[~seen].mean():.2f} right {right[~seen].mean():.2f}" if (~seen).any() else ""
    good = np.isfinite(angle) & np.isfinite(normal)
    return f"off {worst:.2f}  {hidden}  sigma {in_five(error[seen], sigma[seen])}  N {in_five(angle[good], normal[good])}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--pixels", type=int, default=5_000)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--draft", action="store_true")
    asked = parser.parse_args()
    set_threads()
    draft = {"draft": asked.draft}
    stands = belief.DRAFT_COEFFICIENTS if asked.draft else belief.COEFFICIENTS
    c = Coefficients(confidence=stands, sigma=belief.SIGMA_COEFFICIENTS, normals=surface.FITTED)
    pairs = list(of_scenes(SCENES, SIZES, GRAINS, asked.pixels, asked.cache, **draft))
    pairs += of_photographs(PHOTOGRAPHS, PHOTOGRAPHED, asked.pixels, **draft)
    pairs += of_rooms(ROOMS, asked.pixels, asked.cache, **draft)
    pairs += of_plain(PLAIN, asked.pixels, **draft)
    families = sorted({p.family for p in pairs})
    of_fit = [p for p in pairs if p.own]
    if not asked.check:
        c = Coefficients(confidence=confidence_of(of_fit), sigma=c.sigma, normals=c.normals) if asked.draft else fitted(of_fit)
        print("DRAFT_COEFFICIENTS =" if asked.draft else "COEFFICIENTS =", [round(float(x), 3) for x in c.confidence])
        if not asked.draft:
            print("SIGMA_COEFFICIENTS =", tuple(round(float(x), 3) for x in c.sigma))
            print("FITTED =", tuple(round(float(x), 3) for x in c.normals), flush=True)
        for family in families:
            without = Coefficients(confidence=confidence_of([p for p in of_fit if p.family != family]), sigma=c.sigma, normals=c.normals)
            judge(f"{family}, left out", [p for p in pairs if p.family == family], without)
    for family in families:
        judge(f"{family}, of the fit", [p for p in pairs if p.family == family], c)
    del pairs
    judge("rendered, no part in it", list(of_scenes(HELD_OUT, SIZES, GRAINS[:2], asked.pixels, asked.cache, **draft)), c, each=True)
    judge("photographs, no part in it", list(of_photographs(OTHER_PHOTOGRAPHS, OTHERWISE_PHOTOGRAPHED, asked.pixels, **draft)), c)
    judge("rooms, no part in it", list(of_rooms(OTHER_ROOMS, asked.pixels, asked.cache, **draft)), c)
    judge("real boards", list(of_real_boards(asked.pixels, **draft)), c, each=True)
    for pair in of_motorcycle(GRAINS, 10**9, **draft):
        judge(pair.name, [pair], c)


if __name__ == "__main__":
    main()

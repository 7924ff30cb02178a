"""Fits what depth says of itself: confidence and `disparity_sigma` (stereo/confidence.py) and `N_sigma` (surface/normals.py).

Run:  python tests/benchmarks/fit_confidence.py [--cache DIR] [--pixels N] [--check]
In: rendered pairs with exact answers, SCENES and BARE at SIZES, clean and with GRAINS of full range on gamma-coded plates; N pixels of each, drawn at
random.  Out, printed: the three sets of coefficients, ready to be put into those modules, and how true they are on the pairs of the fit and on
those that have no part in it (HELD_OUT, and Motorcycle).  --check fits nothing and judges the coefficients that stand.

Confidence: the likelihood of being within 1 px of truth, floor and all, with a ridge.  Standard deviations: regression of the 0.683 quantile
of the logarithm of the error (Koenker and Bassett 1978) where both eyes see, since 68 % of the errors are to be within what is told; few bad
ones have no say.  `belief.FLOOR` stays as it is: run the fit at several, the likelihood that is printed tells (best from 0.6 to 0.7).
`N_sigma` takes its share of facing as geometry has it.  One after the other: each rests on the one before it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.camera import RectifiedRig
from stereorelight.compare.motorcycle import motorcycle
from stereorelight.compare.normals import angle_deg
from stereorelight.shot.pairs import MATCH_NOISE_PX
from stereorelight.stereo import confidence as belief
from stereorelight.stereo.depth import refined_with_evidence
from stereorelight.stereo.flow import flow_disparity
from stereorelight.stereo.match import search_range
from stereorelight.stereo.proxy import matching_proxy
from stereorelight.stereo.rectify import rectification
from stereorelight.stereo.settings import DepthSettings
from stereorelight.surface import normals as surface
from stereorelight.surface.normals import normals_from_depth
from stereorelight.surface.position import ray_slopes
from stereorelight.synth.rigs import parallel_rig
from stereorelight.threads import set_threads
from tests.benchmarks.bench_depth import pair_of_plates
from tests.benchmarks.bench_depth_scenes import grained, rendered

SCENES = ("bust", "weak", "thin", "table", "statue", "interior", "sphere")
BARE = ("plane", "slanted")  # nothing stands before anything: no ground that is hidden can be wrong, and confidence must not learn from that
HELD_OUT = ("repeat", "two_planes", "box")
SIZES = ((640, 360), (960, 540))
GRAINS = (0.0, 0.01, 0.02)
WITHIN = 0.683
RIDGE = 1e-4  # on coefficients, per pixel: keeps those that say the same from running off against each other
CLIP = 1e-4  # least error, px and degrees: nothing is told finer


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """A pair as the judge sees it, every array (H, W) but normals, and which pixels are judged."""

    name: str
    rig: RectifiedRig
    disparity: np.ndarray
    evidence: belief.Evidence
    error: np.ndarray
    N: np.ndarray
    seen: np.ndarray
    drawn: np.ndarray


def looked_at(name: str, plates: Sequence[np.ndarray], rectified, truth: np.ndarray, N: np.ndarray, seen: np.ndarray, pixels: int) -> Pair:
    views = [rectified.rectify(plate, eye) for plate, eye in zip(plates, ("left", "right"), strict=True)]
    proxy = matching_proxy(*views)
    refined, _, evidence = refined_with_evidence(proxy, search_range(proxy, rectified.rig), DepthSettings(), flow_disparity(proxy))
    known = np.flatnonzero(np.isfinite(truth))
    drawn = np.random.default_rng(0).choice(known, min(pixels, known.size), replace=False)
    error = np.abs(refined.disparity - truth)
    return Pair(name=name, rig=rectified.rig, disparity=refined.disparity, evidence=evidence, error=error, N=N, seen=seen, drawn=drawn)


def of_scenes(names: Sequence[str], sizes: Sequence[tuple[int, int]], grains: Sequence[float], pixels: int, cache: Path | None) -> Iterator[Pair]:
    for size in sizes:
        rectified = rectification(parallel_rig(size))
        per = rectified.rig.left.fx * rectified.rig.baseline_m
        for name in names:
            made = rendered(name, size, cache)
            for grain in grains:
                rng = np.random.default_rng(1)
                plates = [grained(made[eye], grain, rng) for eye in ("left", "right")]
                told = f"{name} {size[0]}x{size[1]} {100 * grain:.0f} %"
                yield looked_at(told, plates, rectified, per / made["Z"], made["N"], made["flags"] == 0, pixels)


def of_motorcycle(grains: Sequence[float], pixels: int) -> Iterator[Pair]:
    left, right, rectified = pair_of_plates()
    pair, per = motorcycle(), rectified.rig.left.fx * rectified.rig.baseline_m
    truth = np.where(np.isfinite(pair.disparity), pair.disparity, np.nan).astype(np.float32)
    Z = (per / (truth + rectified.rig.doffs_px)).astype(np.float32)
    N = normals_from_depth(Z, rectified.rig.left, noise_per_m=0.1 / per)  # the scanned truth is rough by itself
    for grain in grains:
        rng = np.random.default_rng(7)
        plates = [grained(p, grain, rng) if grain else p for p in (left, right)]
        yield looked_at(f"motorcycle {100 * grain:.0f} %", plates, rectified, truth, N, pair.nonoccluded, pixels)


def confidence_evidence(e: belief.Evidence) -> np.ndarray:
    """(H W, 11) in the order of `belief.EVIDENCE`."""
    edge = np.minimum(e.spread, 6) / 6
    columns = (
        np.ones_like(edge), e.confirmed, e.flow_agrees, edge, np.log(np.maximum(e.sigma, 1e-3) / 0.03), e.confirmed_nearby, e.flow_agrees_nearby,
        edge * e.confirmed_nearby, edge * e.flow_agrees_nearby, np.log(1 + e.misfit), e.alone,
    )  # fmt: skip
    return np.stack([c.ravel() for c in columns], axis=1).astype(np.float64)


def sigma_evidence(e: belief.Evidence, confidence: np.ndarray) -> np.ndarray:
    clumped = np.maximum(e.clumped, belief.LEAST_CLUMPED) / belief.USUALLY_CLUMPED
    columns = (np.ones_like(confidence), np.log(np.maximum(e.sigma, 1e-3) / 0.03), np.log((1.005 - confidence) / 0.02), np.log(clumped))
    return np.stack([c.ravel() for c in columns], axis=1).astype(np.float64)


def fitted_confidence(A: np.ndarray, right: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The coefficients, but for the last, of ground where the eyes share nothing: that was fitted on photographs, and stands."""
    alone = A[:, -1]
    floor2 = (belief.FLOOR + alone * (belief.LOWER - belief.FLOOR)) ** 2
    scale = 1 + floor2
    held = float(belief.COEFFICIENTS[-1])
    still = np.arange(A.shape[1] - 1) > 0  # the constant is free

    def loss(c: np.ndarray) -> tuple[float, np.ndarray]:
        p = 1 / (1 + np.exp(-np.clip(A[:, :-1] @ c + held * alone, -30, 30)))
        told = np.clip(np.sqrt((p * p + floor2) / scale), 1e-6, 1 - 1e-6)
        value = -(weight * (right * np.log(told) + (1 - right) * np.log(1 - told))).sum()
        by_told = -weight * (right / told - (1 - right) / (1 - told))
        by_c = A[:, :-1].T @ (by_told * p / (scale * told) * p * (1 - p))
        return value + RIDGE * (c[still] ** 2).sum(), by_c + 2 * RIDGE * c * still

    found = minimize(loss, belief.COEFFICIENTS[:-1].astype(np.float64), jac=True, method="L-BFGS-B", options={"maxiter": 2000})
    print(f"confidence, floor {belief.FLOOR}: log loss {found.fun:.5f}", flush=True)
    return np.append(found.x, held)


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
    sure = belief.confidence_from_evidence(pair.evidence, c.confidence.astype(np.float32))
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


def fitted(pairs: Sequence[Pair]) -> Coefficients:
    c = Coefficients(confidence=belief.COEFFICIENTS, sigma=belief.SIGMA_COEFFICIENTS, normals=surface.FITTED)
    weight = np.concatenate([np.full(p.drawn.size, 1 / p.drawn.size) for p in pairs]) / len(pairs)  # every pair counts alike
    error = np.concatenate([p.error.ravel()[p.drawn] for p in pairs])
    full = np.concatenate([np.full(p.drawn.size, not p.name.startswith(BARE)) for p in pairs])
    A = np.concatenate([confidence_evidence(p.evidence)[p.drawn] for p in pairs])
    found = fitted_confidence(A[full], (error[full] <= 1).astype(np.float64), weight[full] / weight[full].sum())
    c = Coefficients(confidence=found, sigma=c.sigma, normals=c.normals)
    seen = np.concatenate([p.seen.ravel()[p.drawn] for p in pairs])
    A = np.concatenate([sigma_evidence(p.evidence, told_of(p, c)[0])[p.drawn] for p in pairs])
    sigma = fitted_quantile(A[seen], np.log(np.maximum(error[seen], CLIP) / 0.03), weight[seen], np.array(c.sigma))
    c = Coefficients(confidence=c.confidence, sigma=tuple(sigma), normals=c.normals)
    rows, angles, weights = [], [], []
    for p in pairs:
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
    asked = parser.parse_args()
    set_threads()
    c = Coefficients(confidence=belief.COEFFICIENTS, sigma=belief.SIGMA_COEFFICIENTS, normals=surface.FITTED)
    pairs = list(of_scenes((*SCENES, *BARE), SIZES, GRAINS, asked.pixels, asked.cache))
    if not asked.check:
        c = fitted(pairs)
        print("COEFFICIENTS =", [round(float(x), 3) for x in c.confidence])
        print("SIGMA_COEFFICIENTS =", tuple(round(float(x), 3) for x in c.sigma))
        print("FITTED =", tuple(round(float(x), 3) for x in c.normals), flush=True)
    judge("scenes of the fit", pairs, c, each=True)
    del pairs
    judge("rendered, no part in it", list(of_scenes(HELD_OUT, SIZES[:1], GRAINS[:2], asked.pixels, asked.cache)), c, each=True)
    for pair in of_motorcycle(GRAINS, 10**9):
        judge(pair.name, [pair], c)


if __name__ == "__main__":
    main()

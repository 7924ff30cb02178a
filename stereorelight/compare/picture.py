"""Relit pictures against the truth, scene-linear: relative RMS, PSNR, SSIM, what an eye would see, and the light alone.

In: pictures (H, W, 3) float, linear Rec.709 light, NaN where unknown.  Out: figures by region, and a `Measured` with its maps.

relative RMS : root mean square of the error over that of the truth, per cent; one number that exposure does not change.
PSNR, SSIM   : of the linear picture with `peak` as its white (scikit-image; SSIM with the Gaussian window of Wang et al. 2004).
CIEDE2000    : mean colour difference of the two as an sRGB display would show them, `peak` as its white (scikit-image).
light alone  : relative RMS of what was added, the plate taken away, both pictures blurred: what a light did, and not how the plate looks.

A pixel without an answer counts as no light, in every figure: answering less never looks better."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stereorelight.arrays import Bool, Float32, Float64, UInt8, as_float32
from stereorelight.compare.figures import Blink, ErrorMap, Figure, Measured
from stereorelight.errors import PassError

BLUR_PX = 2.0  # of both pictures before light is compared: grain and aliasing are not light
SSIM_SIGMA = 1.5  # of the window, px, as Wang et al. have it
SSIM_REACH = 5  # half its width, which scikit-image cuts at 3.5 sigma
LIGHT_SCALE = 0.25  # of the truth's RMS: full colour of the light's error map


@dataclass(frozen=True, kw_only=True)
class PictureFigures:
    """Figures of one region.

    pixels : how many have known truth.   cover_percent : share of those that have an answer.
    relative_rms_percent, psnr_db, ssim, de2000 : see the module; psnr_db is inf for two equal pictures.
    """

    pixels: int
    cover_percent: float
    relative_rms_percent: float
    psnr_db: float
    ssim: float
    de2000: float

    def figures(self, region: str) -> list[Figure]:
        """The same as figures of a row."""
        row: dict[str, Any] = {"table": "picture", "region": region}
        return [
            Figure(name="pixels", value=float(self.pixels), digits=0, high_is_good=True, **row),
            Figure(name="cover", value=self.cover_percent, unit="%", digits=1, high_is_good=True, **row),
            Figure(name="relative_rms", value=self.relative_rms_percent, unit="%", digits=2, column="relative RMS", **row),
            Figure(name="psnr", value=self.psnr_db, unit="dB", digits=2, column="PSNR", high_is_good=True, **row),
            Figure(name="ssim", value=self.ssim, digits=4, column="SSIM", high_is_good=True, **row),
            Figure(name="de2000", value=self.de2000, digits=2, column="CIEDE2000", **row),
        ]


@dataclass(frozen=True, kw_only=True)
class LightFigures:
    """One light in one region.

    relative_rms_percent : of its error, over the truth's RMS there.
    gain    : what the found light is of the true one, by least squares; 1 is neither too bright nor too dark.
    centred_percent : relative RMS once that gain is taken out: what is wrong with its shape.
    """

    pixels: int
    relative_rms_percent: float
    gain: float
    centred_percent: float

    def figures(self, light: str, region: str) -> list[Figure]:
        """The same as figures of a row."""
        row: dict[str, Any] = {"table": "light alone", "region": light if region == "all" else f"{light} in {region}"}
        return [
            Figure(name="light_rms", value=self.relative_rms_percent, unit="%", digits=2, column="relative RMS", **row),
            Figure(name="light_gain", value=self.gain, digits=3, column="gain", **row),
            Figure(name="light_shape", value=self.centred_percent, unit="%", digits=2, column="without gain", **row),
        ]


def _pair(result: npt.ArrayLike, truth: npt.ArrayLike, what: str) -> tuple[Float32, Float32, Bool]:
    """Both pictures and where the truth is known.  Raises PassError."""
    t = as_float32(truth, f"true {what}", channels=3)
    r = as_float32(result, f"{what} to judge", channels=3, size_hw=(t.shape[0], t.shape[1]))
    known: Bool = np.asarray(np.isfinite(t).all(axis=-1))
    if not known.any():
        raise PassError(f"the true {what} is unknown at every pixel: nothing to compare with")
    if not (known & np.isfinite(r).all(axis=-1)).any():
        raise PassError(f"the {what} and its truth have no known pixel in common; do they belong to the same frame and eye?")
    return r, t, known


def _regions(mattes: Mapping[str, npt.ArrayLike] | None, known: Bool) -> dict[str, Bool]:
    """`all`, and the inside of each matte (above a half)."""
    regions = {"all": known}
    for name, matte in (mattes or {}).items():
        inside = np.asarray(matte)
        if inside.shape != known.shape:
            raise PassError(f"matte {name!r} must be of shape {known.shape}, got {inside.shape}")
        regions[name] = known & (inside if inside.dtype == np.bool_ else np.nan_to_num(inside) > 0.5)
    return regions


def blurred(picture: npt.NDArray[Any], sigma_px: float) -> Float64:
    """`picture` (H, W, 3) through a Gaussian of `sigma_px`; what is not known is no light; the border goes on as it ends."""
    from skimage.filters import gaussian

    filled = np.where(np.isfinite(picture), picture, 0).astype(np.float64)
    if sigma_px <= 0:
        return filled
    out: Float64 = gaussian(filled, sigma=sigma_px, mode="nearest", channel_axis=-1, preserve_range=True)
    return out


def light_figures(result: npt.ArrayLike, truth: npt.ArrayLike, *, region: npt.ArrayLike | None = None, blur_px: float = BLUR_PX) -> LightFigures:
    """How well light alone was found.

    result, truth : (H, W, 3) what a light adds, linear; NaN counts as nothing added.
    region        : (H, W) bool, where to look; everywhere when None.
    blur_px       : sigma of the Gaussian that both go through first; 0 for none.
    Raises        : PassError for sizes that differ, and where no true light falls into the region.
    """
    t = as_float32(truth, "true light", channels=3)
    r = as_float32(result, "light to judge", channels=3, size_hw=(t.shape[0], t.shape[1]))
    where = np.ones(t.shape[:2], np.bool_) if region is None else np.asarray(region)
    if where.dtype != np.bool_ or where.shape != t.shape[:2]:
        raise PassError(f"the region must be bool of shape {t.shape[:2]}, got {where.dtype} {where.shape}")
    if not where.any():
        raise PassError("the region holds no pixel: nothing to compare")
    a, b = blurred(r, blur_px)[where], blurred(t, blur_px)[where]
    power = float((b * b).mean())
    if not power > 0:
        raise PassError("no true light falls there: an error relative to it has no meaning")
    gain = float((a * b).mean()) / power
    off, shape = float(((a - b) ** 2).mean()), float(((a - gain * b) ** 2).mean())
    return LightFigures(
        pixels=int(where.sum()), relative_rms_percent=100 * (off / power) ** 0.5, gain=gain, centred_percent=100 * (shape / power) ** 0.5
    )


def displayed(picture: npt.NDArray[Any], peak: float) -> Float32:
    """(H, W, 3) 0..1 as an sRGB display shows it (IEC 61966-2-1), `peak` as its white."""
    x = np.clip(np.nan_to_num(picture) / peak, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def ssim_map(result: npt.NDArray[Any], truth: npt.NDArray[Any], peak: float) -> Float64:
    """(H, W) structural similarity of every pixel, the mean of its channels."""
    from skimage.metrics import structural_similarity

    if min(truth.shape[:2]) < 2 * SSIM_REACH + 1:
        raise PassError(f"SSIM needs pictures of {2 * SSIM_REACH + 1} x {2 * SSIM_REACH + 1} pixels or more, got {truth.shape[1]} x {truth.shape[0]}")
    _, whole = structural_similarity(
        truth, result, data_range=peak, channel_axis=-1, gaussian_weights=True, sigma=SSIM_SIGMA, use_sample_covariance=False, full=True
    )
    mean: Float64 = whole.mean(axis=-1)
    return mean


def picture_figures(
    result: npt.ArrayLike, truth: npt.ArrayLike, *, mattes: Mapping[str, npt.ArrayLike] | None = None, peak: float = 1.0
) -> dict[str, PictureFigures]:
    """Figures of a picture, everywhere and inside each matte.

    result, truth : (H, W, 3) linear, NaN where unknown.   mattes : (H, W) bool, or numbers of which above a half is inside.
    peak          : what counts as white.
    Raises        : PassError for sizes that differ, where nothing is known or nothing overlaps, and for a peak that is not above 0.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    if not peak > 0:
        raise PassError(f"peak, what counts as white, must be > 0, got {peak!r}")
    r, t, known = _pair(result, truth, "picture")
    answered: Bool = np.asarray(np.isfinite(r).all(axis=-1))
    a = np.where(np.isfinite(r), r, 0).astype(np.float64)
    b = np.where(known[..., None], t, 0).astype(np.float64)
    a[~known] = 0
    squared = ((a - b) ** 2).mean(axis=-1)
    power = (b * b).mean(axis=-1)
    similar = ssim_map(a, b, peak)
    seen = deltaE_ciede2000(rgb2lab(displayed(b, peak)), rgb2lab(displayed(a, peak)))
    out = {}
    for name, region in _regions(mattes, known).items():
        n = int(region.sum())
        if not n:
            out[name] = PictureFigures(
                pixels=0, **dict.fromkeys(("cover_percent", "relative_rms_percent", "psnr_db", "ssim", "de2000"), float("nan"))
            )
            continue
        error, light = float(squared[region].mean()), float(power[region].mean())
        # SSIM and scikit-image leave out the border, where the window is not whole.
        inner = region.copy()
        for edge in (np.s_[:SSIM_REACH], np.s_[-SSIM_REACH:], np.s_[:, :SSIM_REACH], np.s_[:, -SSIM_REACH:]):
            inner[edge] = False
        out[name] = PictureFigures(
            pixels=n,
            cover_percent=100 * float(answered[region].mean()),
            relative_rms_percent=100 * (error / light) ** 0.5 if light > 0 else float("nan"),
            psnr_db=float("inf") if error == 0 else float(10 * np.log10(peak**2 / error)),
            ssim=float(similar[inner].mean()) if inner.any() else float("nan"),
            de2000=float(seen[region].mean()),
        )
    return out


def picture_measured(
    result: npt.ArrayLike,
    truth: npt.ArrayLike,
    *,
    plate: npt.ArrayLike | None = None,
    plate_gain: float = 1.0,
    lights: Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]] | None = None,
    mattes: Mapping[str, npt.ArrayLike] | None = None,
    peak: float = 1.0,
    blur_px: float = BLUR_PX,
) -> Measured:
    """All that can be said of a relit picture.

    plate, plate_gain : adds the light alone: both pictures less plate * plate_gain.
    lights            : by name, (found, true) layers (H, W, 3): adds each light by itself.
    The rest as in `picture_figures` and `light_figures`.  A light that does not fall into a region is left out there.
    """
    r, t, known = _pair(result, truth, "picture")
    figures = [f for name, found in picture_figures(r, t, mattes=mattes, peak=peak).items() for f in found.figures(name)]
    error = (r - t).mean(axis=-1).astype(np.float32)
    maps = [ErrorMap(title="picture, mean of the channels", error=error, known=known, scale=0.1 * peak, unit="linear")]
    alone = dict(lights or {})
    if plate is not None:
        base = as_float32(plate, "plate", channels=3, size_hw=(t.shape[0], t.shape[1])) * np.float32(plate_gain)
        alone = {"all lights": (r - base, t - base), **alone}
    regions = _regions(mattes, known)
    for light, (found_light, true_light) in alone.items():
        for region, where in regions.items():
            try:
                told = light_figures(found_light, true_light, region=where, blur_px=blur_px)
            except PassError:
                if region == "all" and where.any() and np.asarray(found_light).shape != np.asarray(true_light).shape:
                    raise
                continue
            figures += told.figures(light, region)
        a, b = blurred(np.asarray(found_light), blur_px).mean(axis=-1), blurred(np.asarray(true_light), blur_px).mean(axis=-1)
        rms = float(np.sqrt((b[known] ** 2).mean()))
        if rms > 0:
            off = (a - b).astype(np.float32)
            maps.append(ErrorMap(title=f"light alone: {light}", error=off, known=known, scale=LIGHT_SCALE * rms, unit="linear"))
    shown = [Blink(title="picture", truth=_shown(t, peak), result=_shown(r, peak))]
    return Measured(what="picture", figures=tuple(figures), maps=tuple(maps), blinks=tuple(shown))


def _shown(picture: Float32, peak: float) -> UInt8:
    return np.rint(255 * displayed(picture, peak)).astype(np.uint8)

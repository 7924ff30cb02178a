"""Shading as evidence: exact where light and shape are known, silent about paint, steady, and never worse than what it was given."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest

from stereorelight.camera import Camera
from stereorelight.engine import shading as engine
from stereorelight.errors import PassError
from stereorelight.surface.normals import normals_and_sigma
from stereorelight.surface.plate_light import basis, plate_light
from stereorelight.surface.shading import ShadedSurface, refine_by_shading

SIZE = (240, 180)
FX_B = 250.0 * 0.065
CAMERA = Camera(size=SIZE, K=np.array([[250.0, 0, 119.5], [0, 250.0, 89.5], [0, 0, 1]]))
LIGHT = np.array([-0.55, 0.45, 0.70]) / np.linalg.norm([-0.55, 0.45, 0.70])
NOISE_PX = 0.15
NORMALS_DEG = 18.0  # what two thirds of the normals of such a depth are within
WINDOW_PX = 6.0  # sigma of the blur that stands for a matcher's window

Floats = npt.NDArray[np.float64]
Cloth = tuple[ShadedSurface, Floats, Floats, npt.NDArray[np.float32], npt.NDArray[np.float32]]


def angle_deg(a: npt.ArrayLike, b: npt.ArrayLike) -> Floats:
    p, q = np.broadcast_arrays(np.asarray(a, np.float64), np.asarray(b, np.float64))
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(p, q), axis=-1), (p * q).sum(-1)))


def matched(Z: Floats, seed: int = 1) -> npt.NDArray[np.float32]:
    """Z as matching with wide windows sees it: errors that are the same over a window."""
    from scipy import ndimage

    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=Z.shape), WINDOW_PX)
    return (FX_B / (FX_B / Z + NOISE_PX * noise / noise.std())).astype(np.float32)


def waves() -> tuple[Floats, Floats]:
    """Z and N of a swelling cloth, 1 m away: N from Z's own exact derivatives."""
    rays = CAMERA.rays(CAMERA.pixel_grid())
    x, y = rays[..., 0], rays[..., 1]

    def v(x: Floats, y: Floats) -> Floats:
        return 0.022 * np.cos(22 * x + 4 * y) + 0.018 * np.sin(24 * y - 6 * x) + 0.15 * x

    step = 1e-5
    p = (v(x + step, y) - v(x - step, y)) / (2 * step)
    q = (v(x, y + step) - v(x, y - step)) / (2 * step)
    N = np.stack([-p, q, 1 - x * p - y * q], -1)
    return np.exp(-v(x, y)), N / np.linalg.norm(N, axis=-1, keepdims=True)


def lit(N: Floats, albedo: npt.ArrayLike, *, noise: float = 0.01, seed: int = 2) -> npt.NDArray[np.float32]:
    shade = 0.15 + 0.7 * np.maximum(N @ LIGHT, 0)
    picture = np.asarray(albedo) * shade[..., None] * (1 + noise * np.random.default_rng(seed).normal(size=(*shade.shape, 3)))
    return picture.astype(np.float32)


def sigma_m(Z: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return (Z * Z / FX_B * NOISE_PX).astype(np.float32)


CLOTH = (0.30, 0.42, 0.55)


@pytest.fixture(scope="module")
def cloth() -> Cloth:
    Z, N = waves()
    coarse, plate = matched(Z), lit(N, CLOTH)
    return shaded_cloth(coarse, plate), Z, N, coarse, plate


def shaded_cloth(coarse: npt.NDArray[np.float32], plate: npt.NDArray[np.float32]) -> ShadedSurface:
    """Both errors told as they are: those of disparity are shared by fewer pixels here than the fit expects, and normals suffer more."""
    given, _ = normals_and_sigma(coarse, CAMERA)
    return refine_by_shading(plate, coarse, CAMERA, Z_sigma=sigma_m(coarse), N=given, N_sigma=np.full(coarse.shape, NORMALS_DEG, np.float32))


def test_the_system_is_the_least_of_its_own_sum_of_squares() -> None:
    rng = np.random.default_rng(0)
    shape = (13, 17)

    def some(edge: str) -> npt.NDArray[np.float32]:
        a = rng.random(shape).astype(np.float32)
        if edge in ("last", "rows"):
            a[-1] = 0
        if edge in ("last", "columns"):
            a[:, -1] = 0
        if edge == "rows":
            a[0] = 0
        if edge == "columns":
            a[:, 0] = 0
        return a

    data, shading, turn, cross, bx, by = some(""), some("last"), some("last"), some("last"), some("columns"), some("rows")
    pull, left, gu, gv, du, dv = (rng.standard_normal(shape).astype(np.float32) for _ in range(6))
    A, rhs = engine.assemble(data=data, pull=pull, shading=shading, left=left, gu=gu, gv=gv, turn=turn, du=du, dv=dv, bends=(bx, by, cross))
    best = engine.solve(A, rhs, steps=1000).astype(np.float64)

    def cost(x: Floats) -> float:
        c = np.s_[:-1, :-1]
        xu = (x[:-1, 1:] - x[:-1, :-1] + x[1:, 1:] - x[1:, :-1]) / 2
        xv = (x[1:, :-1] - x[:-1, :-1] + x[1:, 1:] - x[:-1, 1:]) / 2
        total = (data * (x - pull) ** 2).sum() + (shading[c] * (gu[c] * xu + gv[c] * xv - left[c]) ** 2).sum()
        total += (turn[c] * ((xu - du[c]) ** 2 + (xv - dv[c]) ** 2)).sum()
        total += (cross[c] * (x[:-1, :-1] - x[:-1, 1:] - x[1:, :-1] + x[1:, 1:]) ** 2).sum()
        total += (bx[:, 1:-1] * (x[:, :-2] - 2 * x[:, 1:-1] + x[:, 2:]) ** 2).sum()
        return float(total + (by[1:-1] * (x[:-2] - 2 * x[1:-1] + x[2:]) ** 2).sum())

    for _ in range(4):
        step = 1e-2 * rng.standard_normal(shape)
        up, down = cost(best + step) - cost(best), cost(best - step) - cost(best)
        assert up > 0
        assert abs(up - down) < 2e-3 * up  # at the least, it rises alike both ways


def test_derivatives_of_shading_are_those_of_its_value() -> None:
    rng = np.random.default_rng(3)
    v = (0.02 * rng.standard_normal((6, 7))).astype(np.float32)
    f = 4.0  # a focal length of few pixels, so that slopes are gentle
    rays = np.zeros((6, 6, 7), np.float32)
    rays[0], rays[1], rays[2], rays[5] = 0.1, -0.2, f, f
    labels, light, floor = (
        np.zeros((6, 7), np.int16),
        np.array([[0.5, -0.2, 0.1, 0.3, 0.05, 0.02, -0.04, 0.03, 0.01]], np.float32),
        np.full(1, 0.01, np.float32),
    )
    _, gu, gv, _ = engine.shade(v, rays, labels, light, floor)
    rows, columns = np.indices(v.shape, dtype=np.float32)
    step = np.float32(2e-3)
    for g, ramp in ((gu, columns), (gv, rows)):
        up = engine.shade(v + step * ramp, rays, labels, light, floor)[0]
        down = engine.shade(v - step * ramp, rays, labels, light, floor)[0]
        np.testing.assert_allclose(((up - down) / (2 * step))[:-1, :-1], g[:-1, :-1], rtol=0.02, atol=2e-3)


def test_the_light_comes_back_from_a_sphere_of_normals() -> None:
    y, x = np.mgrid[-1:1:180j, -1:1:240j]
    inside = x * x + y * y < 0.95
    N = np.stack([x, -y, np.sqrt(np.maximum(1 - x * x - y * y, 0.05))], -1)
    N /= np.linalg.norm(N, axis=-1, keepdims=True)
    true = np.array([0.4, -0.1, 0.12, 0.2, 0.03, 0.02, -0.02, 0.01, 0.02])
    grey = basis(N) @ true
    found = plate_light(np.repeat(grey[..., None], 3, -1).astype(np.float32), N.astype(np.float32), inside.astype(np.float32))
    assert len(found.explained) == 1
    assert found.explained[0] > 0.99
    ratio = (basis(N) @ found.coefficients[0])[inside] / grey[inside]
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.05


def test_cloth_that_matching_sees_badly_is_seen_well(cloth: Cloth) -> None:
    found, Z, N, coarse, _ = cloth
    given, _ = normals_and_sigma(coarse, CAMERA)
    inner = np.s_[8:-8, 8:-8]
    before, after = np.median(angle_deg(given, N)[inner]), np.median(angle_deg(found.N, N)[inner])
    assert found.trust.any()
    assert after < 0.5 * before
    assert after < 6.5
    assert np.median(np.abs(found.Z - Z)[inner]) < 0.8 * np.median(np.abs(coarse - Z)[inner])
    np.testing.assert_allclose(np.linalg.norm(found.N, axis=-1), 1, atol=1e-4)


def test_its_sigma_is_of_the_size_of_its_error(cloth: Cloth) -> None:
    found, _, N, _, _ = cloth
    inner = np.s_[8:-8, 8:-8]
    error = float(np.quantile(angle_deg(found.N, N)[inner], 0.68))
    assert 0.5 < float(np.median(found.N_sigma[inner])) / error < 2  # it was measured on heads, of which this cloth is none


def test_a_painted_wall_stays_as_it_was() -> None:
    from scipy import ndimage

    rays = CAMERA.rays(CAMERA.pixel_grid())
    Z = 1.5 / (1 + 0.2 * rays[..., 0])
    paint = np.exp(0.5 * ndimage.gaussian_filter(np.random.default_rng(5).normal(size=Z.shape), 4) * 10)
    n = np.array([-0.2, 0, 1]) / np.linalg.norm([-0.2, 0, 1])
    plate = lit(np.broadcast_to(n, (*Z.shape, 3)), (0.4 * paint)[..., None] * np.ones(3))
    coarse = matched(Z, seed=7)
    given, sigma = normals_and_sigma(coarse, CAMERA)
    found = refine_by_shading(plate, coarse, CAMERA, Z_sigma=sigma_m(coarse), N=given, N_sigma=sigma)
    true = angle_deg(given, np.broadcast_to(n, given.shape))
    assert np.median(angle_deg(found.N, np.broadcast_to(n, given.shape))) <= np.median(true) * 1.02


def test_where_disparity_is_good_and_cloth_is_printed_nothing_is_touched() -> None:
    Z, N = waves()
    exact = Z.astype(np.float32)
    rng = np.random.default_rng(8)
    albedo = 0.4 * np.exp(0.25 * rng.normal(size=(45, 60))).repeat(4, 0).repeat(4, 1)
    found = refine_by_shading(lit(N, albedo[..., None] * np.ones(3)), exact, CAMERA, Z_sigma=(sigma_m(exact) * 0.02).astype(np.float32))
    assert not found.trust.any()
    np.testing.assert_array_equal(found.Z, exact)
    assert found.weight.max() == 0


def test_no_strength_gives_back_what_came() -> None:
    Z, N = waves()
    coarse = matched(Z)
    given, sigma = normals_and_sigma(coarse, CAMERA)
    found = refine_by_shading(lit(N, CLOTH), coarse, CAMERA, Z_sigma=sigma_m(coarse), N=given, N_sigma=sigma, strength=0)
    np.testing.assert_array_equal(found.Z, coarse)
    np.testing.assert_array_equal(found.N, given)
    np.testing.assert_array_equal(found.N_sigma, sigma)


def test_the_same_bits_on_any_number_of_threads(cloth: Cloth) -> None:
    found, _, _, coarse, plate = cloth
    before = numba.get_num_threads()
    try:
        for threads in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(threads)
            again = shaded_cloth(coarse, plate)
            np.testing.assert_array_equal(found.Z, again.Z)
            np.testing.assert_array_equal(found.N, again.N)
    finally:
        numba.set_num_threads(before)


def test_unknown_depth_stays_unknown_and_a_brighter_plate_says_the_same() -> None:
    Z, N = waves()
    coarse, plate = matched(Z), lit(N, CLOTH)
    coarse[60:90, 100:140] = np.nan
    a = refine_by_shading(plate, coarse, CAMERA, Z_sigma=sigma_m(coarse))
    b = refine_by_shading((0.5 * plate).astype(np.float32), coarse, CAMERA, Z_sigma=sigma_m(coarse))
    assert np.isnan(a.Z[60:90, 100:140]).all()
    assert np.isfinite(a.Z[np.isfinite(coarse)]).all()
    assert np.median(angle_deg(a.N, b.N)[np.isfinite(coarse)]) < 0.1


@pytest.mark.parametrize(
    ("change", "word"), [({"strength": -1.0}, "strength"), ({"quality": "finest"}, "quality"), ({"Z_sigma": np.zeros((3, 3), np.float32)}, "Z_sigma")]
)
def test_nonsense_is_refused_in_words(change: dict[str, object], word: str) -> None:
    Z = np.ones((180, 240), np.float32)
    plate = np.full((180, 240, 3), 0.5, np.float32)
    given: dict[str, object] = {"Z_sigma": sigma_m(Z)}
    with pytest.raises(PassError, match=word):
        refine_by_shading(plate, Z, CAMERA, **(given | change))  # type: ignore[arg-type]


def test_depth_and_normals_are_one_surface(cloth: Cloth) -> None:
    found, _, _, coarse, _ = cloth
    inner = np.s_[8:-8, 8:-8]
    of_depth, of_given = (normals_and_sigma(Z, CAMERA, radii_px=(1, 2))[0] for Z in (found.Z, coarse))
    assert np.median(angle_deg(of_depth, found.N)[inner]) < 2
    assert np.median(angle_deg(of_given, found.N)[inner]) > 6  # else the first line says nothing


def test_outlines_are_left_to_disparity() -> None:
    """The cloth cut out before a wall 30 cm behind it: beside the cut, whether sharp or a slope of 5 px, normals are what they were."""
    from scipy import ndimage

    Z, N = waves()
    inside = np.zeros(Z.shape, bool)
    inside[20:-20, 40:-40] = True
    coarse = np.where(inside, matched(Z), 1.4).astype(np.float32)
    slope = (1 / ndimage.uniform_filter(1 / coarse.astype(np.float64), 5)).astype(np.float32)
    plate = np.where(inside[..., None], lit(N, CLOTH), np.float32(0.3)).astype(np.float32)
    cut = ndimage.binary_dilation(inside) & ~ndimage.binary_erosion(inside)
    for depth in (coarse, slope):
        given, _ = normals_and_sigma(depth, CAMERA)
        found = refine_by_shading(plate, depth, CAMERA, Z_sigma=sigma_m(depth), N=given, N_sigma=np.full(Z.shape, NORMALS_DEG, np.float32))
        assert found.weight[60:120, 80:160].mean() > 0.8
        np.testing.assert_array_equal(found.N[cut], given[cut])


def fair(albedo: Floats, noise_px: float, shade: float = 1.0) -> tuple[float, float]:
    """Median error of normals as given and with shading, of a cloth of this albedo (H, W), all errors told as they are."""
    Z, N = waves()
    coarse = (FX_B / (FX_B / Z + (FX_B / matched(Z).astype(np.float64) - FX_B / Z) * noise_px / NOISE_PX)).astype(np.float32)
    given, _ = normals_and_sigma(coarse, CAMERA)
    error = angle_deg(given, N)
    told = np.full(Z.shape, np.quantile(error, 0.68), np.float32)
    sigma = (sigma_m(coarse) * noise_px / NOISE_PX).astype(np.float32)
    plate = lit(N, albedo[..., None] * np.array(CLOTH)) * np.float32(shade)
    found = refine_by_shading(plate, coarse, CAMERA, Z_sigma=sigma, N=given, N_sigma=told)
    inner = np.s_[8:-8, 8:-8]
    return float(np.median(error[inner])), float(np.median(angle_deg(found.N, N)[inner]))


@pytest.mark.parametrize("strength", [0.08, 0.2])
def test_texture_is_not_printed_into_good_depth(strength: float) -> None:
    from scipy import ndimage

    rng = np.random.default_rng(11)
    grain = sum((g / g.std() for g in (ndimage.gaussian_filter(rng.normal(size=SIZE[::-1]), s) for s in (1, 2, 4))), np.zeros(SIZE[::-1]))
    before, after = fair(np.exp(strength * grain / 3**0.5), 0.03)
    assert after < 1.1 * before


def test_stripes_of_the_same_colour_make_no_relief() -> None:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    for stripes in (0.25 * np.sin(2 * np.pi * y / 14), 0.4 * np.sign(np.sin(2 * np.pi * (x + y) / 30))):
        before, after = fair(np.exp(stripes), 0.1)
        assert after < 1.05 * before

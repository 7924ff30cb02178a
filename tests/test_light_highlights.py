"""Highlights of lights with a size against sums over their surface, float64: small and large, near and far, cut by the horizon."""

from __future__ import annotations

import numpy as np
import pytest

from stereorelight.engine import lobe_rows
from stereorelight.light.lights import Light, RectLight, SphereLight
from stereorelight.light.shade import light_layers

Array = np.ndarray
EXACT = 1e-3
FLOOR = 1e-2  # of the most that a lobe can hold: below it the error is held against this
NOTHING = 1e-14  # of a lobe's middle: what is less adds nothing to a sum
COUNT, FINE = 600, 1300  # places along each side of what is summed, where the lobe is broad and where it is narrow


def shone(P: Array, N: Array, light: Light) -> Array:
    p, n = (np.ascontiguousarray(v.reshape(1, -1, 3), np.float32) for v in (P, N))
    return light_layers(p, n, np.ones_like(p), [light])["light_a_specular"][0, :, 0].astype(np.float64)


def places(light: Light, p: Array, normal: Array, mirrored: Array) -> tuple[Array, Array]:
    """Cosines (n, m) between `mirrored` and the ways from p to places of the light, and what each counts for: its solid angle over the light's
    area as seen head on, as far as it stands above the horizon."""
    count = COUNT if light.exponent < 100 else FINE
    if isinstance(light, RectLight):
        (w, h), (u, v) = light.size_m, light.sides
        across = round(count * np.sqrt(w / h))
        x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (across, count**2 // across))
        to = np.array(light.position_m) - p
        d2 = np.add.outer((x * w + to @ u) ** 2, (y * h + to @ v) ** 2) + (to @ light.shines_to) ** 2

        def along(a: Array) -> Array:
            return np.add.outer(to @ a + x * w * (u @ a), y * h * (v @ a))

        cell = (abs(w * u @ normal) / len(x) + abs(h * v @ normal) / len(y)) / 2
        above = np.clip(0.5 + along(normal) / (2 * cell), 0, 1)
        far = np.sqrt(d2)
        return along(mirrored) / far, above * max(float(-(to @ light.shines_to)), 0.0) / (d2 * far) / d2.size
    assert isinstance(light, SphereLight)
    t = (np.arange(count) + 0.5) / count
    to = np.array(light.position_m) - p
    d = np.linalg.norm(to)
    sine = min(light.radius_m / d, 1.0)
    low = t * (1 - np.sqrt(1 - sine**2))
    a = to / d
    e = np.cross(a, [1, 0, 0] if abs(a[0]) < 0.8 else [0, 1, 0])
    e /= np.linalg.norm(e)
    phi = 2 * np.pi * t
    f = np.cross(a, e)

    def cosines(b: Array) -> Array:
        return ((1 - low) * (a @ b))[:, None] + np.outer(np.sqrt(low * (2 - low)), np.cos(phi) * (e @ b) + np.sin(phi) * (f @ b))

    return cosines(mirrored), (cosines(normal) > 0) * (2 * low[-1] * count / (count - 0.5) / light.radius_m**2 / count**2)


def summed(P: Array, N: Array, light: Light) -> Array:
    wanted = []
    for p, n in zip(P.astype(np.float32).astype(float), N.astype(np.float32).astype(float)):
        view = -p / np.linalg.norm(p)
        cosine, share = places(light, p, n, 2 * (n @ view) * n - view)
        seen = cosine > NOTHING ** (1 / light.exponent)
        wanted.append((cosine[seen] ** light.exponent * share[seen]).sum())
    return np.array(wanted)


def lobe_most(light: Light) -> float:
    """All of the lobe, over the light's area."""
    area = light.size_m[0] * light.size_m[1] if isinstance(light, RectLight) else np.pi * light.radius_m**2  # type: ignore[attr-defined]
    return float(2 * np.pi / (light.exponent + 1) / area)


def facing(seed: int, light: Light, nearest: float, count: int = 24) -> tuple[Array, Array]:
    """Places about a light that lie before the camera, with normals that mirror the view somewhere about the light."""
    rng = np.random.default_rng(seed)
    centre = np.array(light.position_m)  # type: ignore[attr-defined]
    P, N = [], []
    while len(P) < count:
        way = rng.normal(size=3)
        p = centre + way / np.linalg.norm(way) * rng.uniform(nearest, 2.0)
        to = centre - p + rng.normal(size=3) * rng.choice([0.02, 0.1, 0.5])
        n = to / np.linalg.norm(to) - p / np.linalg.norm(p)
        n = n / np.linalg.norm(n) + rng.normal(size=3) * rng.choice([0.0, 0.2, 0.6])
        n /= np.linalg.norm(n)
        if n @ p < 0 and (not isinstance(light, RectLight) or (p - centre) @ light.shines_to > 0.05):
            P.append(p)
            N.append(n)
    return np.array(P), np.array(N)


def held(light: Light, P: Array, N: Array) -> Array:
    got, wanted = shone(P, N, light), summed(P, N, light)
    np.testing.assert_allclose(got, wanted, rtol=EXACT, atol=EXACT * FLOOR * lobe_most(light))
    return wanted


EXPONENTS = (1.0, 7.5, 30.0, 300.0)


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("size", [(0.02, 0.05), (0.5, 0.5), (1.6, 0.1), (2.5, 1.5)])
def test_rectangle(size: tuple[float, float], exponent: float) -> None:
    light = RectLight(
        name="a", position_m=(0.2, 0.3, -3), size_m=size, direction=(0.3, -0.2, 1), roll_deg=30, diffuse=0, specular=1, exponent=exponent
    )
    wanted = held(light, *facing(3, light, 0.2))
    assert (wanted > 1e-3 * wanted.max()).sum() > 8


@pytest.mark.parametrize("exponent", EXPONENTS)
@pytest.mark.parametrize("radius", [0.02, 0.2, 0.6])
def test_ball(radius: float, exponent: float) -> None:
    light = SphereLight(name="a", position_m=(0.2, 0.3, -3), radius_m=radius, diffuse=0, specular=1, exponent=exponent)
    wanted = held(light, *facing(4, light, radius * 1.05))
    assert (wanted > 1e-3 * wanted.max()).sum() >= 8


@pytest.mark.parametrize(
    "light",
    [
        RectLight(name="a", position_m=(0, 0.2, -1), size_m=(0.4, 0.3), aim_m=(0, 0, -2), specular=1, exponent=12),
        SphereLight(name="a", position_m=(0, 0.2, -1), radius_m=0.2, specular=1, exponent=12),
    ],
    ids=["rectangle", "ball"],
)
def test_setting_behind_the_horizon(light: Light) -> None:
    """From wholly above the horizon to wholly below it, in small steps: no jump where another sum takes over."""
    angles = np.radians(np.linspace(-70, 130, 101))
    P = np.tile([0.0, 0.0, -2.0], (len(angles), 1))
    N = np.stack([0.3 * np.ones_like(angles), np.sin(angles), np.cos(angles)], axis=1)
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    wanted = held(light, P, N)
    assert (wanted == 0).any()
    assert np.abs(np.diff(shone(P, N, light))).max() < 1.01 * np.abs(np.diff(wanted)).max()


def test_where_two_sums_meet_they_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Just inside and just outside of what INSIDE is taken for: the same light, moved by a thousandth."""
    exponent, half = 31.0, 0.1
    d = half * np.sqrt((exponent + 1) / float(lobe_rows._NEAR))
    for kind in ("rectangle", "ball"):
        P = np.array([[0.05, 0.02, -1 - d * (1 + side * 1e-4)] for side in (-1, 1)])
        N = np.tile([0.1, -0.05, 0.99], (2, 1))
        N /= np.linalg.norm(N, axis=1, keepdims=True)
        common = {"name": "a", "position_m": (0.0, 0.0, -1.0), "specular": 1.0, "exponent": exponent}
        light: Light = (
            RectLight(**common, size_m=(2 * half, 2 * half), direction=(0, 0, -1)) if kind == "rectangle" else SphereLight(**common, radius_m=half)
        )
        near, far = shone(P, N, light)
        assert near == pytest.approx(far, rel=1e-3)
        held(light, P, N)


@pytest.mark.parametrize("z", [-0.99, -1.0, -1.2])
def test_a_camera_beside_the_light_sees_no_false_highlight(z: float) -> None:
    """Surfaces seen edge on, with a light near the eye: the mirrored view looks away from it, and the sum beyond 90 degrees must close."""
    rng = np.random.default_rng(2)
    N = rng.normal(size=(400, 3))
    N[:, 2] = rng.uniform(0.001, 0.1, 400)
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    P = np.tile([0.0, 0.0, -2.0], (400, 1))
    for light in (
        RectLight(name="a", position_m=(0.05, 0, z), size_m=(0.5, 0.7), direction=(0, 0, -1), specular=1, exponent=20),
        SphereLight(name="a", position_m=(0.05, 0, z), radius_m=0.3, specular=1, exponent=20),
    ):
        assert shone(P, N, light).max() < 1e-5 * lobe_most(light)

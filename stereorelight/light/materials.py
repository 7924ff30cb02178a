"""What a surface does with light: materials by matte, and the albedo of a GGX lobe.

In: `[[materials]]` tables.  Out: `Material`s; each takes the place of the lights' own settings where its matte says so.
Colours are linear."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np

from stereorelight.errors import ShotError
from stereorelight.light.base import NAME, Light
from stereorelight.light.checks import Checked, Vector, checked_keys
from stereorelight.light.lights import PointLight

LEAST_ALPHA = 0.002  # of GGX: a highlight smaller than that of roughness 0.045 is smaller than any pixel
_SAMPLES = 96  # in each of two directions, for the albedo of a lobe


@dataclass(frozen=True, kw_only=True)
class Material(Checked):
    """A surface, held by a matte.  A key that is None leaves what the light says.

    name, matte : what it is called, and the name of the matte in which it stands.
    model       : "phong", "ggx" or "lambert" (no highlight).
    diffuse, specular, exponent, normalised, specular_tint, roughness, f0, ior, rim, rim_power, rim_color, scatter, scatter_mm :
                  as a `Light` has them.
    Where mattes overlap, a later material lies over an earlier one; where none reaches, the light's own settings hold.
    Raises      : ShotError naming the material, the key, what was wanted and what came.
    """

    what = "material"

    name: str
    matte: str
    model: str | None = None
    diffuse: float | None = None
    specular: float | None = None
    exponent: float | None = None
    normalised: bool | None = None
    specular_tint: Vector | None = None
    roughness: float | None = None
    f0: float | None = None
    ior: float | None = None
    rim: float | None = None
    rim_power: float | None = None
    rim_color: Vector | None = None
    scatter: str | None = None
    scatter_mm: float | Vector | None = None

    def __post_init__(self) -> None:
        for key in ("name", "matte"):
            value = getattr(self, key)
            if not isinstance(value, str) or not NAME.fullmatch(value):
                raise self._error(key, "must be a letter followed by letters, digits and _", repr(value))
        try:
            checked = PointLight(name=self.name, position_m=(0.0, 0.0, 0.0), **self._given())
        except ShotError as error:
            raise ShotError(str(error).replace("light", "material", 1)) from None
        for key in self._given():
            object.__setattr__(self, key, getattr(checked, key))

    def _given(self) -> dict[str, Any]:
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("name", "matte")}
        return {key: value for key, value in found.items() if value is not None}

    def under(self, light: Light) -> Light:
        """`light` as it shines on this material."""
        given = self._given()
        # One of the two says what the surface reflects; the light's other one goes.
        if "ior" in given:
            given["f0"] = None
        elif "f0" in given:
            given["ior"] = None
        if "scatter" in given:  # and so does its length
            given.setdefault("scatter_mm", None)
        return replace(light, **given)


def materials_from_dicts(tables: Sequence[Mapping[str, Any]]) -> tuple[Material, ...]:
    """The materials of a file's `[[materials]]` tables, in order.  Raises ShotError with the nearest known key, and for two of one name."""
    found: list[Material] = []
    for index, table in enumerate(tables):
        if not isinstance(table, Mapping):
            raise ShotError(f"material number {index + 1} must be a table of keys, got {table!r}; begin each material with [[materials]]")
        label = f"material {table['name']!r}" if "name" in table else f"material number {index + 1}"
        if "type" in table:
            raise ShotError(f"{label}: key 'type' is unknown (did you mean 'model'?)")
        checked_keys(table, Material, label)
        material = Material(**table)
        if any(material.name == other.name for other in found):
            raise ShotError(f"{label}: name is taken by an earlier material")
        found.append(material)
    return tuple(found)


@lru_cache(maxsize=256)
def glow_table(alpha: float, nodes: int) -> tuple[float, ...]:
    """(1 - E) / E at `nodes` steps of sqrt(N.V), E the directional albedo of a GGX lobe without Fresnel.

    1 + F0 (1 - E) / E times the lobe gives back what one bounce between facets loses (Turquin, Practical multiple scattering
    compensation for microfacet models, 2019): with F0 = 1 nothing is lost.  E by stratified sampling of visible normals (Heitz 2018)."""
    u1, u2 = np.meshgrid((np.arange(_SAMPLES) + 0.5) / _SAMPLES, (np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    r, phi = np.sqrt(u1), 2 * np.pi * u2
    t1, t2 = r * np.cos(phi), r * np.sin(phi)
    table = []
    for k in range(nodes):
        mu = max((k / (nodes - 1)) ** 2, 1e-3)
        s = math.sqrt(1 - mu * mu)
        stretched = np.array([alpha * s, 0.0, mu])
        stretched /= np.linalg.norm(stretched)
        lean = 0.5 * (1 + stretched[2])
        t = (1 - lean) * np.sqrt(1 - t1 * t1) + lean * t2
        up = np.sqrt(np.maximum(0, 1 - t1 * t1 - t * t))
        side = np.array([0.0, 1.0, 0.0])
        other = np.cross(stretched, side)
        m = t1[..., None] * side + t[..., None] * other + up[..., None] * stretched
        m *= (alpha, alpha, 1)
        m[..., 2] = np.maximum(m[..., 2], 1e-9)
        m /= np.linalg.norm(m, axis=-1, keepdims=True)
        vm = m[..., 0] * s + m[..., 2] * mu
        nl = 2 * vm * m[..., 2] - mu
        nl_up = np.maximum(nl, 1e-9)
        a2 = alpha * alpha
        seen = np.sqrt(mu * mu * (1 - a2) + a2)
        lit = np.sqrt(nl_up * nl_up * (1 - a2) + a2)
        # G2 / G1(V) of height-correlated Smith.
        passed = np.where(nl > 0, nl_up * (mu + seen) / (nl_up * seen + mu * lit), 0.0)
        E = float(passed.mean())
        table.append((1 - E) / E)
    return tuple(table)


def covers(materials: Sequence[Material], mattes: Mapping[str, Any]) -> tuple[Any, list[Any]]:
    """What is left for the lights' own settings, and each material's share, (H, W) each, summing to 1; later ones lie on top."""
    left: Any = 1.0
    shares: list[Any] = []
    for material in reversed(materials):
        held = np.nan_to_num(np.asarray(mattes[material.matte], dtype=np.float32), nan=0.0)
        shares.insert(0, left * held)
        left = left * (1 - held)
    return left, shares


def reflectance(light: Light) -> float:
    """F0: as given, of the index of refraction, or 0.04."""
    if light.f0 is not None:
        return light.f0
    return 0.04 if light.ior is None else ((light.ior - 1) / (light.ior + 1)) ** 2


def ggx_alpha(light: Light) -> float:
    """roughness^2, at least LEAST_ALPHA."""
    return max(light.roughness**2, LEAST_ALPHA)

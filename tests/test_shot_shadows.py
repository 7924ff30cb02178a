"""Shadows of a light file and a shot: each light's own layer, what cannot be known beside it, occlusion, and PLY from the command line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from stereorelight.camera import Camera
from stereorelight.cli.group import main
from stereorelight.errors import PassError, ShotError
from stereorelight.footage.exr import write_exr
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.stills import write_still
from stereorelight.passes import Flag, Frame
from stereorelight.shot.lighting import Lighting, lighting_of
from stereorelight.shot.schema import read_light_file
from stereorelight.surface.position import position_from_depth

SIZE = (96, 64)
CAMERA = Camera.from_fov(50, SIZE)
V, U = np.mgrid[0:64, 0:96]
ON = (abs(U - 55) < 12) & (abs(V - 32) < 12)
PLATE = np.random.default_rng(0).uniform(0.1, 0.9, (64, 96, 3)).astype(np.float32)
SUN = '[[lights]]\nname = "sun"\ntype = "directional"\naim = [-0.6, 0, -0.8]\nspecular = 0.2\n'


def card() -> dict[str, np.ndarray]:
    """A card at 1.5 m before a wall at 2 m."""
    Z = np.where(ON, np.float32(1.5), np.float32(2.0))
    N = np.zeros((*Z.shape, 3), np.float32)
    N[..., 2] = 1
    return {"Z": Z, "P": position_from_depth(Z, CAMERA), "N": N}


def lighting(folder: Path, text: str) -> Lighting:
    (folder / "lights.toml").write_text(text)
    return lighting_of(read_light_file(folder / "lights.toml"), numbers=[], plate=lambda n: PLATE)


@pytest.mark.parametrize("method", ["march", "rays"])
def test_a_shadow_is_in_its_lights_layers_and_apart(tmp_path: Path, method: str) -> None:
    plain, shaded, half = (
        lighting(tmp_path, SUN + more).lit(1, plate=PLATE, passes=card(), camera=CAMERA)
        for more in ("", f'shadow = "{method}"\n', f'shadow = "{method}"\nshadow_density = 0.5\n')
    )
    shadow, unknown = shaded.passes()["shadow_sun"], shaded.passes()["shadow_sun_unknown"]
    assert 0.01 < (shadow == 0).mean() < 0.2
    assert 0 < (unknown == 1).mean() < 1
    assert set(np.unique(shadow)) == {0, 1}
    for part in ("diffuse", "specular"):
        layer = f"light_sun_{part}"
        np.testing.assert_allclose(shaded.layers[layer], plain.layers[layer] * shadow[..., None], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(half.layers[layer], plain.layers[layer] * (0.5 + 0.5 * shadow[..., None]), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(shaded.beauty, PLATE + sum(shaded.layers.values()), rtol=1e-6)
    assert "shadow_sun" not in plain.passes()


def test_a_shadow_that_comes_by_keys_has_its_layers_on_every_frame(tmp_path: Path) -> None:
    made = lighting(tmp_path, SUN + 'shadow = { keys = [[1, "off"], [5, "rays"]], ease = "step" }\n')
    off, on = (made.lit(n, plate=PLATE, passes=card(), camera=CAMERA).shadows for n in (1, 5))
    assert list(off) == list(on) == ["shadow_sun", "shadow_sun_unknown"]
    assert (off["shadow_sun"] == 1).all()
    assert (off["shadow_sun_unknown"] == 0).all()
    assert (on["shadow_sun"] == 0).any()


def test_thickness_is_millimetres_or_the_subjects_matte(tmp_path: Path) -> None:
    inside = (U - 55) ** 2 + (V - 32) ** 2 < 144
    write_still(tmp_path / "card.png", np.repeat(inside[..., None] * np.uint8(255), 3, axis=-1))
    bulge = 1.5 - 0.2 * np.sqrt(np.maximum(1 - ((U - 55) ** 2 + (V - 32) ** 2) / 144, 0))
    passes = card()
    passes["Z"] = np.where(inside, bulge, 2.0).astype(np.float32)
    passes["P"] = position_from_depth(passes["Z"], CAMERA)
    text = SUN + 'shadow = "rays"\n'
    open_ = '[shadows]\noutside = "open"\n'
    matte = '[[mattes]]\nname = "card"\nfile = "card.png"\n'
    thin, thick, closed = (
        lighting(tmp_path, text + more).lit(1, plate=PLATE, passes=passes, camera=CAMERA).shadows
        for more in (open_, open_ + "thickness = 600\n", matte + open_ + 'thickness = "matte"\nmatte = "card"\n')
    )
    behind = thin["shadow_sun_unknown"] > 0.5
    assert behind.sum() > 50
    assert (thick["shadow_sun"][behind] < 0.5).mean() > 0.95
    assert 0.2 < (closed["shadow_sun"][behind] < 0.5).mean() < 0.95
    assert (closed["shadow_sun"] <= thin["shadow_sun"]).all()


def test_wrapped_light_and_spots_keep_their_own_reach(tmp_path: Path) -> None:
    passes = card()
    passes["N"] = np.where((U < 20)[..., None], np.float32([-1, 0, 0]), passes["N"]).astype(np.float32)
    wrapped = lighting(tmp_path, SUN + 'wrap = 0.9\nshadow = "rays"\n').lit(1, plate=PLATE, passes=passes, camera=CAMERA)
    assert (wrapped.layers["light_sun_diffuse"][:, :20] > 0).all(), "what is turned away is wrapped light's own to shade"
    spot = '[[lights]]\nname = "spot"\ntype = "spot"\nposition_m = [0, 0, 0]\naim_m = [0, 0, -2]\ncone_deg = 6\npenumbra_deg = 2\nshadow = "rays"\n'
    lit = lighting(tmp_path, spot).lit(1, plate=PLATE, passes=card(), camera=CAMERA)
    assert (lit.shadows["shadow_spot"][0] == 1).all(), "no rays are sent beside the cone"


def test_what_is_far_away_hides_nothing_that_is_known_to_be_empty(tmp_path: Path) -> None:
    passes = card()
    for name in ("Z", "P", "N"):
        passes[name] = passes[name].copy()
        passes[name][:, 70:] = np.nan
    told = passes | {"flags": np.where(U >= 70, Flag.TOO_FAR, 0).astype(np.uint16)}
    low = '[[lights]]\nname = "low"\ntype = "directional"\naim = [-0.9, 0, -0.44]\nshadow = "march"\n'
    made = lighting(tmp_path, low)
    unknown, sky = (made.lit(1, plate=PLATE, passes=p, camera=CAMERA).shadows["shadow_low_unknown"] for p in (passes, told))
    beside = (slice(2, 10), slice(40, 60))
    assert unknown[beside].mean() > 0.9
    assert sky[beside].mean() <= unknown[beside].mean()
    assert np.isfinite(sky).all()


def test_occlusion_has_its_passes_and_dims_the_environment(tmp_path: Path) -> None:
    write_exr(tmp_path / "sky.exr", {c: np.ones((8, 16), np.float32) for c in "RGB"})
    text = '[environment]\nfile = "sky.exr"\nreflection = 0.5\nfresnel = false\n'
    plain = lighting(tmp_path, text).lit(1, plate=PLATE, passes=card(), camera=CAMERA)
    dimmed = lighting(tmp_path, text + "occlusion = true\n[occlusion]\nradius_m = 1.0\n").lit(1, plate=PLATE, passes=card(), camera=CAMERA)
    ao, bent = (dimmed.passes()[name] for name in ("ao", "bent"))
    beside = (V == 32) & (abs(U - 55) > 13) & (abs(U - 55) < 16)
    assert ao[beside].max() < 0.98
    assert (ao[ON] == 1).all()
    assert (bent[(V == 32) & (U == 70), 0] > 0.01).all(), "what is open lies away from the card"
    np.testing.assert_allclose(np.linalg.norm(bent, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(dimmed.layers["env_diffuse"], plain.layers["env_diffuse"] * ao[..., None], rtol=2e-3, atol=1e-6)
    assert (dimmed.layers["env_reflection"] <= plain.layers["env_reflection"] + 1e-6).all()
    np.testing.assert_allclose(dimmed.layers["env_reflection"][ON], plain.layers["env_reflection"][ON], rtol=1e-5)
    assert "ao" not in plain.passes()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (SUN + 'shadow = "ray"\n', "lights.toml:1.*'ray' is unknown; did you mean 'rays'|shadow 'ray' is unknown"),
        (SUN + "shadow_samples = 0\n", "shadow_samples must be a whole number in 1 ... 1024, got 0"),
        (SUN + "shadow_density = 2\n", "shadow_density must be a number in 0 ... 1, got 2"),
        (SUN + "shadow_radius_m = 0.1\n", "shadow_radius_m belongs to point"),
        (SUN + '[shadows]\nthicknes = "thin"\n', "unknown key 'thicknes'; did you mean 'thickness'"),
        (SUN + "[shadows]\nthickness = -5\n", "thickness"),
        (SUN + "[occlusion]\nradius_m = 0\n", "radius_m"),
        (SUN.replace("sun", "a") + 'shadow = "rays"\n' + SUN.replace("sun", "a_unknown") + 'shadow = "rays"\n', "shadow_a_unknown"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(ShotError, match=told) as caught:
        lighting(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "lights.toml" in str(caught.value)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    made = lighting(tmp_path, SUN + 'shadow = "rays"\n[shadows]\nthickness = "matte"\nmatte = "actr"\n')
    with pytest.raises(ShotError, match=r"lights\.toml: \[shadows\] matte 'actr' is missing"):
        made.lit(1, plate=PLATE, passes=card(), camera=CAMERA)
    with pytest.raises(PassError, match="camera that saw the passes"):
        lighting(tmp_path, SUN + 'shadow = "rays"\n').lit(1, plate=PLATE, passes=card(), camera=None)
    nothing = {name: np.full_like(array, np.nan) for name, array in card().items()}
    with pytest.raises(PassError, match="no known pixel"):
        lighting(tmp_path, SUN + 'shadow = "rays"\n').lit(1, plate=PLATE, passes=nothing, camera=CAMERA)


def test_from_the_command_line(tmp_path: Path) -> None:
    """relight writes the shadow's layers; export writes the surface, and refuses what it cannot."""
    write_still(tmp_path / "plate.png", np.rint(PLATE * 255).astype(np.uint8))
    write_frame(tmp_path / "passes.exr", Frame(passes=card(), camera=CAMERA))
    (tmp_path / "lights.toml").write_text(SUN + 'shadow = "march"\n')

    def run(*words: str) -> tuple[int, str]:
        result = CliRunner().invoke(main, [str(tmp_path / w) if "." in w else w for w in words])
        return result.exit_code, result.output

    code, output = run("relight", "plate.png", "passes.exr", "--lights", "lights.toml", "--out", "relit.exr")
    assert code == 0, output
    relit = read_frame(tmp_path / "relit.exr")
    assert {"shadow_sun", "shadow_sun_unknown"} <= set(relit)
    code, output = run("export", "passes.exr", "--to", "ply", "--out", "a.ply", "--plate", "plate.png")
    assert code == 0, output
    head = (tmp_path / "a.ply").read_bytes().partition(b"end_header")[0].decode()
    assert "property uchar red" in head
    assert "property list uchar int vertex_indices" in head
    code, output = run("export", "passes.exr", "--to", "ply", "--out", "a.ply")
    assert code == 1
    assert "exists already" in output
    code, output = run("export", "relit.exr", "--to", "ply", "--out", "b.ply")
    assert code == 1
    assert "has no pass Z" in output
    assert not (tmp_path / "b.ply").exists()
    code, output = run("export", "passes.exr", "--to", "opencv", "--points", "--out", "c.yaml")
    assert code == 2

"""docs/gallery.md runs as it stands, here at a tenth of its size, and every picture that it shows is made and is one."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

from stereorelight.comp import relight
from stereorelight.footage.frames import read_frame
from stereorelight.footage.plates import read_plate

DOCS = Path(__file__).parents[1] / "docs"
SIZE = (160, 90)
MOST_BYTES = 200_000


def gallery() -> object:
    spec = importlib.util.spec_from_file_location("gallery", DOCS / "gallery.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_the_page_runs_and_makes_its_pictures(tmp_path: Path) -> None:
    page = gallery()
    text = page.PAGE.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    page.run_page(text, tmp_path, SIZE)  # type: ignore[attr-defined]
    names = page.SHOWN.findall(text)  # type: ignore[attr-defined]
    assert len(names) >= 9
    for name in names:
        picture = page.pasted(name, tmp_path)  # type: ignore[attr-defined]
        assert picture.shape[1] >= SIZE[0] // 2
        assert picture.astype(float).std() > 8, f"{name} is all but even"
    # What the page says of its pictures.
    lit = read_frame(tmp_path / "two_lights.exr")
    layers = {name: lit[name] for name in lit if name.startswith("light_")}
    np.testing.assert_allclose(relight(read_plate(tmp_path / "room.exr"), layers, plate_gain=0.03), lit["beauty"], rtol=4e-3, atol=1e-4)
    assert set(layers) >= {"light_pendant_diffuse", "light_window_diffuse"}


def test_every_picture_of_the_page_is_in_the_repository() -> None:
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    for name in re.findall(r"\((img/[\w.]+)\)", text):
        path = DOCS / name
        assert path.is_file(), f"{name} is missing; run python docs/gallery.py"
        assert path.stat().st_size <= MOST_BYTES
    assert "Middlebury" in text

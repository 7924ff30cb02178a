"""The import rules of docs/architecture.md, held as data: who may import whom, and where each backend lives."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent / "stereorelight"
BASE = {"errors", "arrays", "lens", "camera", "passes"}
STEPS = {"calibration", "health", "stereo", "surface", "light", "compare", "synth"}
# room -> rooms of ours that it may import (itself always)
MAY_IMPORT: dict[str, set[str]] = {
    "__init__": BASE | STEPS | {"comp", "footage", "interchange", "shot"},
    "errors": set(),
    "arrays": {"errors"},
    "lens": {"errors", "arrays"},
    "camera": {"errors", "arrays", "lens"},
    "passes": {"errors", "arrays", "camera"},
    "files": {"errors"},
    "threads": {"errors"},
    "memory": set(),
    "engine": {"errors", "arrays", "threads", "memory"},
    **{step: BASE | {"engine", "threads"} for step in STEPS},
    "comp": BASE | {"engine"},
    "footage": BASE | {"files", "threads", "engine"},
    "interchange": BASE | {"files"},
    "shot": BASE | STEPS | {"comp", "footage", "interchange", "files", "threads", "engine"},
    "cli": BASE | STEPS | {"comp", "footage", "interchange", "files", "threads", "shot", "farm", "__init__"},
}
BACKEND_HOMES: dict[str, tuple[str, ...]] = {
    "cv2": ("calibration", "health", "stereo", "footage", "threads"),
    "OpenEXR": ("footage/exr.py",),
    "PyOpenColorIO": ("footage/colour.py", "footage/colour_config.py"),
    "av": ("footage/movie",),
    "click": ("cli",),
    "numba": ("engine", "threads"),
    "llvmlite": ("engine",),
    "pydantic": ("shot", "light", "cli"),
    "tomlkit": ("shot",),
    "rich": ("cli",),
    "matplotlib": ("footage", "compare", "calibration"),
    "skimage": ("shot", "compare"),
    "jinja2": ("compare", "calibration", "shot"),
    "embreex": ("surface",),
    "onnxruntime": ("stereo/onnx_matcher.py",),
    "pxr": ("interchange/usd.py",),
    "dask": ("farm.py",),
}


def imports() -> list[tuple[Path, int, str]]:
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found += [(path, node.lineno, alias.name) for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}:{node.lineno}: relative import; write it out"
                base = node.module or ""
                names = [f"{base}.{alias.name}" for alias in node.names] if base == "stereorelight" else [base]
                found += [(path, node.lineno, name) for name in names]
    return found


def room_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def broken_rules() -> list[str]:
    broken = []
    for path, line, name in imports():
        where = f"{path.relative_to(ROOT.parent)}:{line}"
        parts = name.split(".")
        if parts[0] == "stereorelight":
            room, target = room_of(path), parts[1] if len(parts) > 1 else "__init__"
            if not (ROOT / target).exists() and not (ROOT / f"{target}.py").exists():
                target = "__init__"
            if target == "__init__" and room != "__init__":
                if parts[1:] != ["__version__"]:
                    broken.append(f"{where}: {room} imports the package itself")
            elif target not in (room, *MAY_IMPORT.get(room, set())):
                broken.append(f"{where}: {room} may not import {target}")
        elif parts[0] in BACKEND_HOMES:
            inside = path.relative_to(ROOT).as_posix()
            if not any(inside == home or inside.startswith((home + "/", home + ".py")) for home in BACKEND_HOMES[parts[0]]):
                broken.append(f"{where}: {parts[0]} belongs in {', '.join(BACKEND_HOMES[parts[0]])}")
    return broken


def test_import_rules() -> None:
    assert not broken_rules(), "\n".join(broken_rules())


def test_every_room_has_a_rule() -> None:
    rooms = {room_of(p) for p in ROOT.rglob("*.py")}
    assert rooms <= set(MAY_IMPORT), f"rooms without a rule: {rooms - set(MAY_IMPORT)}"


HEAVY = ["matplotlib", "numba", "cv2", "skimage", "OpenEXR", "scipy", "rich", "pydantic", "av", "PyOpenColorIO", "jinja2", "onnxruntime"]


@pytest.mark.parametrize("heavy", HEAVY)
def test_import_is_light(heavy: str) -> None:
    code = f"import sys, stereorelight, stereorelight.cli; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0, f"importing stereorelight pulls in {heavy}"

"""Kernels compiled ahead are those that a run calls, and a run without such help does no worse."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from stereorelight.shot import ahead

# What a process of its own compiled or loaded, kernel by kernel; in this one, other tests' kernels would be among them.
SIGNATURES = """
import contextlib
import json
from stereorelight.shot import ahead
{work}
told = {{}}
for stage in ahead.STAGES.values():
    {each}
    for name, kernel in zip(stage.kernels, ahead.kernels_of(stage)):
        told[stage.module + "." + name] = sorted(map(str, kernel.signatures))
print("told", json.dumps(told))
"""
RUN = """
import numpy as np
from stereorelight.camera import Camera, Rig
from stereorelight.footage.frames import write_frame
from stereorelight.interchange.rigs import write_rig
from stereorelight.passes import Frame
from stereorelight.shot.run import run_shot
from stereorelight.shot.template import shot_text
from pathlib import Path
eye = Camera(size=(96, 64), K=np.array([[80.0, 0, 48], [0, 80, 32], [0, 0, 1]]))
write_rig(Path("rig.json"), Rig(left=eye, right=eye, R_right_left=np.eye(3), t_right_left_m=np.array([-0.1, 0, 0])))
wall = np.random.default_rng(1).uniform(0.1, 0.9, (64, 96, 3)).astype(np.float32)
for name, plate in (("left", wall), ("right", np.roll(wall, -6, axis=1))):
    write_frame(Path(name + ".exr"), Frame(passes={"plate": plate}, camera=eye))
lamp = {"name": "lamp", "type": "point", "position_m": [0.0, 0.0, 0.0], "intensity": 0.3, "specular": 0.1}
Path("shot.toml").write_text(shot_text(left="left.exr", right="right.exr", name="wall", lights=[lamp], plate_gain=0.5, command="shot.toml"))
run_shot("shot.toml")
"""


def signatures(folder: Path, *, work: str = "", each: str = "") -> dict[str, list[str]]:
    done = subprocess.run([sys.executable, "-c", SIGNATURES.format(work=work, each=each)], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.split("told ")[1])


def test_the_stages_compile_what_a_run_calls(tmp_path: Path) -> None:
    ahead_of, run = signatures(tmp_path, each="stage.make()"), signatures(tmp_path, work=RUN)
    for name, called in run.items():
        assert called, f"a run no longer calls {name}"
        assert set(called) <= set(ahead_of[name]), f"{name} is compiled for other arguments than a run gives it"


def test_stages_are_dealt_out_to_all_cores_but_one() -> None:
    names = list(ahead.STAGES)
    assert ahead.shares_of(names, 1) == []
    assert ahead.shares_of(names, 2) == [names]
    assert ahead.shares_of(names, 3) == [names[::2], names[1::2]]
    assert ahead.shares_of(names, 64) == [[name] for name in names]
    assert ahead.shares_of([], 64) == []


def kernel_at(source: Path, cache: Path | None) -> SimpleNamespace:
    code = SimpleNamespace(co_filename=str(source))
    return SimpleNamespace(stats=SimpleNamespace(cache_path=cache and str(cache)), py_func=SimpleNamespace(__code__=code, __name__="_fit"))


def test_a_kernel_is_compiled_where_the_cache_is_younger_than_its_source(tmp_path: Path) -> None:
    source = tmp_path / "planes.py"
    source.touch()
    assert not ahead.compiled(kernel_at(source, tmp_path))
    (tmp_path / "planes._fitted-104.py311.nbi").touch()  # another kernel's
    assert not ahead.compiled(kernel_at(source, tmp_path))
    index = tmp_path / "planes._fit-104.py311.nbi"
    index.touch()
    assert ahead.compiled(kernel_at(source, tmp_path))
    os.utime(index, (1, 1))
    assert not ahead.compiled(kernel_at(source, tmp_path))


def test_without_a_cache_nothing_is_compiled_ahead(tmp_path: Path) -> None:
    assert ahead.compiled(kernel_at(tmp_path / "planes.py", None))


def test_a_helper_compiles_what_runs_not_what_lies_about(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a clone of the project into which it is installed: what lies in the folder would fill a cache that no run looks into."""
    decoy = tmp_path / "stereorelight"
    decoy.mkdir()
    (decoy / "__init__.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)
    assert ahead.helper([]).wait() == 0


@pytest.mark.parametrize("fails", [False, True])
def test_helpers_end_with_the_block(monkeypatch: pytest.MonkeyPatch, fails: bool) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def sleeper(command: list[str], **options: object) -> subprocess.Popen[bytes]:
        started.append(popen([sys.executable, "-c", "import time; time.sleep(60)"]))
        return started[-1]

    monkeypatch.setattr(ahead, "compiled", lambda kernel: False)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 3)
    monkeypatch.setattr(subprocess, "Popen", sleeper)
    with pytest.raises(KeyError) if fails else contextlib.nullcontext(), ahead.compiling_ahead():
        assert len(started) == 2
        assert all(helper.poll() is None for helper in started)
        if fails:
            raise KeyError
    assert all(helper.returncode for helper in started), "they slept to their end"


def test_a_machine_that_starts_no_process_runs_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*args: object, **options: object) -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(ahead, "compiled", lambda kernel: False)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 3)
    monkeypatch.setattr(subprocess, "Popen", none)
    with ahead.compiling_ahead():
        pass

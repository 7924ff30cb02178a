"""The light that is already there, in figures: direction, and a person moved into another light, with exact and recovered normals.

python tests/benchmarks/bench_plate_light.py"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stereorelight.shot.plate_light import Reference, estimated
from tests.plate_lit import bust_under, random_albedo
from tests.test_light_estimate import exact, moved_error, off_deg, recovered

NAMES = ("lamp", "left", "right")


def main() -> None:
    for kind, width in (("exact", 320), ("recovered", 480)):
        for name in NAMES:
            lit = bust_under(name, width)
            seen = exact(name) if kind == "exact" else recovered(name)
            plates = {"own albedo": lit.frame["plate"]} | {f"random {k}": lit.E * random_albedo(lit.subject.shape, k) for k in (1, 2, 3)}
            for what, plate in plates.items():
                frame = Reference(number=None, plate=plate, passes=seen.passes, camera=seen.camera)
                before = time.process_time()
                light = estimated(frame, matte=lit.subject.astype(np.float32), albedo_level=0.36)
                spent = time.process_time() - before
                error = off_deg(light, name) if light.told else float("nan")
                told = f"{kind:10s} {name:6s} {what:11s} off {error:5.1f} deg, said +- {light.sigma_deg:5.1f}; explains {light.explained:5.2f}"
                print(f"{told}; {spent:4.1f} s CPU", flush=True)
        for a, b in (("lamp", "right"), ("right", "lamp"), ("left", "right"), ("right", "left")):
            seen = exact(a) if kind == "exact" else recovered(a)
            print(f"{kind:10s} {a} -> {b}: relative RMS {100 * moved_error(seen, a, b, width):.1f} %", flush=True)


if __name__ == "__main__":
    main()

"""One frame of a shot: its files' names, and its values, each made once or read from the file that holds it.

Plates are upright (a mirrored eye is flipped back) and scene-linear; all passes lie on the ORIGINAL left plate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from stereorelight import __version__
from stereorelight.arrays import Float32
from stereorelight.camera import Camera
from stereorelight.errors import PassError
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.passes import Frame
from stereorelight.shot.depths import material_test, shaded, surface_of
from stereorelight.shot.hints import hints_of
from stereorelight.shot.lighting import Lighting
from stereorelight.shot.lit import Lit
from stereorelight.shot.materials import MaterialsOfShot
from stereorelight.shot.neighbours import Neighbours, search_figures
from stereorelight.shot.pairs import Pair, flip_word, noise_word, read_upright, recover_pair
from stereorelight.shot.repairs import Repairs
from stereorelight.shot.schema import Shot
from stereorelight.stereo.rectify import Rectification
from stereorelight.stereo.repair import repaired
from stereorelight.surface.shading_trust import Judged


@dataclass(kw_only=True, eq=False)
class FrameJob:
    """What the steps of one frame share.

    preview_range_m : nearest and farthest distance of the depth previews, the same for the whole shot.
    lighting        : what lights it; the shot file's lights alone where None.
    near            : the frames about it, which steady its depth; None where it stands alone.
    materials       : of the whole shot, for shading; None judges them by this frame alone.
    """

    shot: Shot
    rectification: Rectification
    pair: Pair
    preview_range_m: tuple[float, float] = (1.0, 10.0)
    search_figures: dict[str, Any] = field(default_factory=dict)
    shading_figures: dict[str, Any] = field(default_factory=dict)
    repairs: Repairs | None = None
    near: Neighbours | None = None
    lighting: Lighting | None = None
    materials: MaterialsOfShot | None = None

    def path(self, kind: str, suffix: str = "exr", *, what: str = "") -> Path:
        """NAME[.what][.frame].suffix in the folder of that kind."""
        number = "" if self.pair.number is None else f".{self.pair.number:04d}"
        return self.shot.folder / kind / f"{self.shot.name}{'.' + what if what else ''}{number}.{suffix}"

    @property
    def depth_path(self) -> Path:
        return self.path("depth")

    @property
    def passes_path(self) -> Path:
        return self.path("passes")

    @property
    def relit_path(self) -> Path:
        return self.path("relit")

    @property
    def receipt_path(self) -> Path:
        return self.path("receipts", "json")

    def preview_path(self, what: str) -> Path:
        return self.path("previews", "png", what=what)

    @property
    def camera(self) -> Camera:
        return self.rectification.original.left

    def words(self, step: str) -> dict[str, str]:
        """What a file's header says of how it was made."""
        return {"software": f"stereorelight {__version__}", "shot": self.shot.name, "step": step} | flip_word(self.rectification, "left")

    @property
    def timecode(self) -> str | None:
        """Time code of the left plate."""
        return self.pair.left.timecode(self.pair.number)

    @property
    def source_words(self) -> dict[str, str]:
        """What the source's own header says (camera, reel, lens ...), to go with the picture."""
        return self.pair.left.source_words(self.pair.number)

    def write(self, path: Path, frame: Frame, *, half: bool = True) -> Path:
        """Write a result with the shot's colour space, and the time code and rate of its source."""
        return write_frame(path, frame, half=half, force=True, colour=self.shot.colour, timecode=self.timecode, rate=self.pair.left.rate)

    @cached_property
    def plates(self) -> tuple[Float32, Float32]:
        """Left and right plate, upright, scene-linear.  Raises PlateError."""
        return read_upright(self.pair, self.rectification, colour=self.shot.colour)

    @cached_property
    def plate(self) -> Float32:
        """The left plate alone: what is relit."""
        if "plates" in self.__dict__:
            return self.plates[0]
        kept = None if self.near is None else self.near.plate(self.pair)
        return kept if kept is not None else self.rectification.upright(self.pair.plate("left", self.shot.colour), "left")

    def recovered(self) -> Frame:
        """Z, confidence and flags, found now."""
        if self.near is not None and self.near.pairs_about(self.pair):
            found, figures = self.near.steadied(self.pair, lambda: self.plates)
            raw = found.frame
            self.search_figures = figures | {"time_frames": list(found.frames), "regained_percent": round(100 * found.regained, 2)}
        else:
            match_colour = self.shot.tables.plates.match_colour
            hints = hints_of(self.shot, self.pair)
            alone = recover_pair(self.pair, self.plates, self.rectification, settings=self.shot.depth, match_colour=match_colour, hints=hints)
            raw, self.search_figures = alone.frame, search_figures(alone)
        frame = replace(raw, number=self.pair.number, metadata=self.words("depth") | noise_word(self.rectification))
        if self.repairs is not None:
            frame = self._repaired(frame, self.repairs)
        self.__dict__["depth"] = frame
        return frame

    def _repaired(self, frame: Frame, repairs: Repairs) -> Frame:
        """The frame after the shot file's repairs.  Raises PassError naming the frame."""
        try:
            frame, done = repaired(frame, repairs.fixes(self.pair, frame.size_hw))
        except PassError as error:
            raise PassError(f"{self.shot.path}: frame {self.pair.name}: {error}") from None
        if done:
            self.search_figures["repairs"] = done
        return frame

    @cached_property
    def depth(self) -> Frame:
        """Z, confidence and flags, from their file."""
        return replace(read_frame(self.depth_path, colour=self.shot.colour), camera=self.camera)

    @property
    def _shading(self) -> dict[str, Any]:
        quality: Literal["standard", "fine"] = "fine" if self.shot.depth.quality == "fine" else "standard"
        return {"strength": self.shot.tables.surface.shading_strength, "quality": quality}

    def _fitted(self) -> Frame:
        """Z, P and N as depth alone has them."""
        return surface_of(self.depth, method=self.shot.tables.surface.method)

    def judged(self) -> Judged:
        """What the frame, its depth found now, says of its materials.  Raises PlateError."""
        self.recovered()
        return material_test(self._fitted(), self.depth, self.plate, **self._shading)

    def made_surface(self) -> Frame:
        """Z, P and N, made now."""
        frame = self._fitted()
        if self.shot.shades:
            materials = None if self.materials is None else self.materials.found
            frame, self.shading_figures = shaded(frame, self.depth, self.plate, **self._shading, materials=materials)
        frame = replace(frame, number=self.pair.number, metadata=self.words("passes"))
        self.__dict__["surface"] = frame
        return frame

    @cached_property
    def surface(self) -> Frame:
        """Z, P and N, from their file."""
        return replace(read_frame(self.passes_path, colour=self.shot.colour), camera=self.camera)

    @cached_property
    def lights(self) -> Lighting:
        """What lights it."""
        return self.lighting or Lighting(setup=self.shot.setup, colour=self.shot.colour, rig=self.rectification.original)

    @cached_property
    def posed_camera(self) -> Camera:
        """The camera where it stands on this frame."""
        return self.lights.camera(self.camera, self.pair.number)

    @cached_property
    def lit(self) -> Lit:
        """Every light's own layers, the relit plate, and what goes with it."""
        return self.lights.lit(self.pair.number, plate=self.plate, passes=self.lit_passes(), camera=self.posed_camera)

    def lit_passes(self) -> dict[str, Any]:
        """The passes that light reads: those of the surface, and of the depth what is asked for."""
        asked = self.shot.setup
        wanted = ["confidence"] if asked.relight.fade > 0 or asked.relight.albedo == "estimated" else []
        wanted += ["Z_sigma", "flags"] if asked.casts or asked.relight.albedo == "estimated" or asked.relight.edges else []
        return {**self.surface, **{name: self.depth[name] for name in wanted if name in self.depth}}

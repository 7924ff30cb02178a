"""The shot file: what it says is what is run; whatever is unknown or misspelt is refused with file, line and the nearest word."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from stereorelight.errors import ShotError
from stereorelight.shot.demo import LIGHTS as DEMO_LIGHTS
from stereorelight.shot.schema import DepthTable, key_lines, read_lights, read_shot
from stereorelight.shot.synthetic import LIGHTS
from stereorelight.shot.template import shot_text
from stereorelight.stereo.settings import DepthSettings

SMALLEST = """\
[plates]
left = "l.png"
right = "r.png"
"""
LIGHT = """\
[[lights]]
name = "key"
type = "point"
position_m = [0.0, 1.0, -1.0]
"""


def shot(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "shot.toml"
    path.write_text(text)
    return path


def refused(path: Path) -> str:
    with pytest.raises(ShotError) as caught:
        read_shot(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_two_plates_are_enough(tmp_path: Path) -> None:
    read = read_shot(shot(tmp_path, SMALLEST))
    assert read.depth == DepthSettings()
    assert read.lights == ()
    assert read.resolved(read.tables.plates.left) == tmp_path / "l.png"
    assert read.folder == tmp_path / "out"


def test_template_reads_back_whole(tmp_path: Path) -> None:
    text = shot_text(
        left="a.####.exr", right="b.####.exr", name="x", lights=DEMO_LIGHTS, plate_gain=0.25, colour_space="linear", depth={"near_m": 1.5}
    )
    read = read_shot(shot(tmp_path, text))
    assert [light.name for light in read.lights] == [light["name"] for light in DEMO_LIGHTS]
    assert read.tables.plates.left == "a.####.exr"
    assert read.tables.plates.colour_space == "linear"
    assert read.tables.relight.plate_gain == 0.25
    assert read.depth.near_m == 1.5
    assert read.name == "x"


def test_every_key_that_the_template_hints_at_is_known(tmp_path: Path) -> None:
    """Uncommenting the template's commented keys gives a shot file that is accepted."""
    lines = shot_text(left="a.####.exr", right="b.####.exr", name="x", lights=LIGHTS).splitlines()
    hints = [
        line
        for line in lines
        if line.startswith("# ") and " = " in line.partition("#")[2].split("  #")[0] and "(" not in line and "camera" not in line
    ]
    assert len(hints) == 11
    text = "\n".join(line.removeprefix("# ") if line in hints else line for line in lines)
    read = read_shot(shot(tmp_path, text))
    plates = read.tables.plates
    assert (plates.frames, plates.layout, plates.right_late_frames, plates.match_colour) == ("1001-1010", "side-by-side", 0, "global")
    assert (read.tables.rig.drift, read.tables.output.movies) == ("shot", ["relit", "wipe"])
    assert (read.depth.near_m, read.depth.far_m, read.depth.time_window) == (0.5, 20.0, 2)
    assert (read.tables.output.preview_near_m, read.tables.output.preview_far_m) == (1.0, 8.0)


def test_every_depth_setting_has_its_key() -> None:
    mattes = {"subject", "ignore"}  # files, which the settings of a recovery do not hold
    assert set(DepthTable.model_fields) - mattes == {f.name for f in fields(DepthSettings)}
    assert DepthSettings(**DepthTable().model_dump(exclude=mattes)) == DepthSettings()


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (SMALLEST + "[dpeth]\n", 4, ["unknown table 'dpeth'", "'depth'"]),
        (SMALLEST + "[depth]\nqualty = 1\n", 5, ["unknown key 'qualty'", "'quality'"]),
        (SMALLEST + '[depth]\nquality = "fien"\n', 5, ["depth.quality", "'fien'", "'fine'"]),
        (SMALLEST + "[depth]\nnear_m = -1.0\n", 5, ["near_m", "> 0"]),
        (SMALLEST + "[depth]\nnear_m = 5.0\nfar_m = 2.0\n", 5, ["near_m", "less than far_m"]),
        (SMALLEST + '[depth]\nnear_m = "near"\n', 5, ["depth.near_m", "number"]),
        (SMALLEST + '[surface]\nmethod = "plan"\n', 5, ["surface.method", "'plane'"]),
        (SMALLEST + "[relight]\nplate_gain = -0.5\n", 5, ["relight.plate_gain", "greater than or equal to 0"]),
        (SMALLEST + '[output]\nname = "a b/c"\n', 5, ["output.name", "letters"]),
        (SMALLEST + "[output]\npreview_near_m = 3.0\npreview_far_m = 2.0\n", 5, ["preview_near_m"]),
        ('[plates]\nleft = "l.png"\n', 1, ["plates.right", "missing"]),
        (SMALLEST + "version = 2\n", 4, ["version"]),
        (SMALLEST + LIGHT.replace("position_m", "positon_m"), 7, ["positon_m", "'position_m'"]),
        (SMALLEST + LIGHT.replace('"point"', '"pont"'), 6, ["'pont'", "'point'"]),
        (SMALLEST + LIGHT + LIGHT.replace("1.0]", "nan]").replace("key", "other"), 11, ["position_m"]),
        (SMALLEST + LIGHT + "intensity = -2.0\n", 8, ["intensity", "'key'"]),
    ],
)
def test_nonsense_is_refused_with_its_line(tmp_path: Path, text: str, line: int, words: list[str]) -> None:
    message = refused(shot(tmp_path, text))
    assert f"shot.toml:{line}: " in message
    for word in words:
        assert word in message, message


def test_two_lights_of_one_name_are_refused(tmp_path: Path) -> None:
    assert "'key'" in refused(shot(tmp_path, SMALLEST + LIGHT + LIGHT))


@pytest.mark.parametrize(("content", "word"), [(b"[plates\n", "TOML"), (b"\xff\xfe\x00", "text file"), (b"left = 1\nleft = 2\n", "TOML")])
def test_what_is_no_toml_is_refused(tmp_path: Path, content: bytes, word: str) -> None:
    path = tmp_path / "shot.toml"
    path.write_bytes(content)
    assert word in refused(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert "missing" in refused(tmp_path / "none.toml")
    assert "cannot be read" in refused(tmp_path)


def test_a_light_file_holds_lights_alone(tmp_path: Path) -> None:
    path = tmp_path / "lights.toml"
    path.write_text(LIGHT)
    assert [light.name for light in read_lights(path)] == ["key"]
    path.write_text(SMALLEST + LIGHT)
    with pytest.raises(ShotError, match=r"lights\.toml:1: unknown table 'plates'"):
        read_lights(path)


def test_key_lines_see_tables_arrays_and_comments() -> None:
    text = '# c\n[a] # note\nx = 1\n"y" = 2\n\n[[l]]\nn = 1\n[[l]]\nn = 2 # [z]\n[a.b]\nq=3\n'
    lines = key_lines(text)
    assert lines["a",] == 2
    assert lines["a", "x"] == 3
    assert lines["a", "y"] == 4
    assert lines["l", 0, "n"] == 7
    assert lines["l", 1, "n"] == 9
    assert lines["a", "b", "q"] == 11


@pytest.mark.parametrize(
    ("quality", "surface", "shades"),
    [
        ("fine", "", True),
        ("standard", "", False),
        ("draft", "", False),
        ("fine", 'shading = "auto"', True),
        ("standard", 'shading = "auto"', False),
        ("standard", 'shading = "on"', True),
        ("fine", 'shading = "off"', False),
    ]
    + [("fine", 'method = "difference"\nshading = "auto"', False)],
)
def test_shading_comes_when_asked_for(tmp_path: Path, quality: str, surface: str, shades: bool) -> None:
    assert read_shot(shot(tmp_path, f'{SMALLEST}\n[depth]\nquality = "{quality}"\n[surface]\n{surface}\n')).shades == shades


@pytest.mark.parametrize(
    ("told", "shading", "strength"), [('"on"', "on", 1.0), ('"off"', "off", 1.0), ("0.5", "on", 0.5), ("0", "off", 1.0), ("2", "on", 2.0)]
)
def test_shading_is_a_word_or_a_strength(tmp_path: Path, told: str, shading: str, strength: float) -> None:
    read = read_shot(shot(tmp_path, f"{SMALLEST}\n[surface]\nshading = {told}\n")).tables.surface
    assert (read.shading, read.shading_strength) == (shading, strength)


def test_a_strength_beyond_reason_is_refused(tmp_path: Path) -> None:
    assert "shading" in refused(shot(tmp_path, f"{SMALLEST}\n[surface]\nshading = 9\n"))

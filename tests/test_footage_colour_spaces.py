"""OpenColorIO's side of colour: published greys, matrices, round trips, names, configs of the user's own, and header words."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stereorelight.errors import PassError, PlateError, ShotError
from stereorelight.footage import colour
from stereorelight.footage.colour import (
    STUDIO_CONFIG,
    ColourSettings,
    check_colour,
    checked_space,
    chromaticities,
    config_digest,
    decode,
    display_picture,
    from_working,
    matrix_to,
    rec709_from_working,
    to_working,
    transfer_table,
    working_space,
)
from stereorelight.footage.exr import read_exr, write_exr
from stereorelight.footage.frames import read_frame, write_frame
from stereorelight.footage.plates import linear_plate, read_plate
from stereorelight.footage.primaries import PRIMARIES, matrix_between
from stereorelight.footage.space_names import ALIASES
from stereorelight.passes import Frame
from stereorelight.threads import set_threads

ACESCG = ColourSettings(working="ACEScg")
# Encoded value of 18 % grey, and half the last printed digit.  ARRI LogC3 white paper 2017 (EI 800); ARRI LogC4 specification 2022;
# Sony S-Log3 technical summary (420 / 1023); Panasonic V-Log reference 2014 (433 / 1023 and printed 0.423311);
# RED white paper 915-0187 (1/3); Canon Log gamma white paper 2020; Blackmagic Gen 5 and DaVinci papers 2020-21 (0.383561, 0.336043);
# Apple Log profile 2023; Academy S-2014-003 and S-2016-001 (0.413588).
GREYS = {
    "LogC3": (0.391007, 5e-7),
    "LogC4": (0.278396, 5e-7),
    "S-Log3": (420 / 1023, 1e-7),
    "S-Log3 S-Gamut3": (420 / 1023, 1e-7),
    "V-Log": (0.423311, 1e-6),
    "Log3G10": (1 / 3, 2e-6),
    "Canon Log 2": (0.398254, 2e-6),
    "Canon Log 3": (0.343389, 1e-6),
    "BMDFilm": (0.383561, 1e-6),
    "DaVinci Intermediate": (0.336043, 5e-7),
    "Apple Log": (0.488272, 1e-6),
    "ACEScc": (0.413588, 5e-7),
    "ACEScct": (0.413588, 5e-7),
}
LOGS = ("LogC3", "LogC4", "S-Log3", "V-Log", "Log3G10", "BMDFilm", "DaVinci Intermediate", "ACEScct")
CAT02 = np.array([[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]])  # CIE 159:2004
OWN = """ocio_profile_version: 2
search_path: luts
roles: {{scene_linear: scene, default: scene{more_roles}}}
file_rules:
  - !<Rule> {{name: Default, colorspace: default}}
displays:
  monitor:
    - !<View> {{name: Film, colorspace: film}}
colorspaces:
  - !<ColorSpace> {{name: scene, encoding: scene-linear}}
  - !<ColorSpace> {{name: film, aliases: [kodak], from_scene_reference: !<ExponentTransform> {{value: 2, direction: inverse}}}}
  - !<ColorSpace> {{name: table, to_scene_reference: !<FileTransform> {{src: missing.cube}}}}
  - !<ColorSpace> {{name: ap0, to_scene_reference: !<MatrixTransform> {{matrix: [{matrix}]}}}}
"""


def own_config(folder: Path, *, interchange: bool = True) -> ColourSettings:
    """A config whose scene space is ACEScg under another name."""
    m = np.eye(4)
    m[:3, :3] = matrix_to("ACES2065-1", "ACEScg", ColourSettings())
    numbers = ", ".join(f"{v:.9g}" for v in m.ravel())
    path = folder / "config.ocio"
    path.write_text(OWN.format(more_roles=", aces_interchange: ap0" if interchange else "", matrix=numbers))
    return ColourSettings(config=str(path), working="scene")


@pytest.mark.parametrize("settings", [ColourSettings(), ACESCG, ColourSettings(working="Linear Rec.2020")], ids=lambda s: s.working)
@pytest.mark.parametrize("space", GREYS)
def test_the_published_grey_is_18_percent(space: str, settings: ColourSettings) -> None:
    encoded, digit = GREYS[space]
    slope = float(np.diff(to_working(np.array([[encoded - 1e-3] * 3, [encoded + 1e-3] * 3]), space, settings)[:, 1])[0]) / 2e-3
    assert to_working(np.full((1, 3), encoded), space, settings) == pytest.approx(0.18, abs=slope * digit + 5e-7)


def test_published_blacks_and_whites() -> None:
    grey = [[v] * 3 for v in (95 / 1023, 598 / 1023)]  # S-Log3 technical summary: 0 % and 90 %
    assert to_working(grey, "S-Log3")[:, 1] == pytest.approx([0, 0.9], abs=1.5e-3)
    assert from_working(np.zeros((1, 3)), "V-Log") == pytest.approx(0.125, abs=1e-6)  # V-Log reference: 128 / 1023 is 0 %
    assert from_working(np.zeros((1, 3)), "LogC3") == pytest.approx(0.092809, abs=1e-6)  # LogC3 EI 800: the curve's own 0


@pytest.mark.parametrize("space", LOGS)
@examples(max_examples=30, deadline=None)
@given(values=hnp.arrays(np.float32, (7, 3), elements=st.floats(-1 / 64, 35 / 32, width=32)))
def test_there_and_back(space: str, values: np.ndarray) -> None:
    for settings in (ColourSettings(), ACESCG):
        back = from_working(to_working(values, space, settings), space, settings)
        # Saturated codes near white leave the other channels what float32 leaves of the largest one.
        spread = np.abs(to_working(values, space, settings)).max(axis=1, keepdims=True)
        assert (np.abs(back - values) <= 1e-5 * np.maximum(spread, 1)).all()


@pytest.mark.parametrize("space", ["sRGB", "rec709", "gamma2.2", "gamma2.4"])
def test_our_formulas_stay_exact_and_change_primaries_elsewhere(space: str) -> None:
    codes = np.random.default_rng(1).uniform(-0.1, 1.1, (50, 3)).astype(np.float32)
    assert np.array_equal(to_working(codes, space), decode(codes, space))
    wanted = decode(codes, space).astype(np.float64) @ matrix_between(PRIMARIES["Linear Rec.709 (sRGB)"], PRIMARIES["ACEScg"]).T
    assert np.abs(to_working(codes, space, ACESCG) - wanted).max() < 1e-6
    assert np.abs(from_working(to_working(codes, space, ACESCG), space, ACESCG) - codes).max() < 1e-5
    assert np.array_equal(to_working(codes, "linear", ACESCG), codes)


def test_matrices_are_the_published_ones() -> None:
    # Rec.709 to AP1, Bradford: printed by the Academy's CTL and by colour-science.
    published = [[0.613097, 0.339523, 0.047379], [0.070194, 0.916354, 0.013452], [0.020616, 0.109570, 0.869815]]
    assert matrix_to("linear Rec.709", "ACEScg", ColourSettings()) == pytest.approx(np.array(published), abs=1.5e-6)
    bt2087 = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]  # ITU-R BT.2087-0, M2
    assert matrix_to("linear Rec.709", "Linear Rec.2020", ColourSettings()) == pytest.approx(np.array(bt2087), abs=6e-5)


@pytest.mark.parametrize("space", PRIMARIES)
def test_the_primaries_we_write_are_those_of_the_config(space: str, monkeypatch: pytest.MonkeyPatch) -> None:
    config = matrix_to(space, "ACES2065-1", ColourSettings())
    apart = [np.abs(matrix_between(PRIMARIES[space], PRIMARIES["ACES2065-1"]) - config).max()]
    monkeypatch.setattr("stereorelight.footage.primaries.BRADFORD", CAT02)  # what most makers' transforms adapt by
    apart.append(np.abs(matrix_between(PRIMARIES[space], PRIMARIES["ACES2065-1"]) - config).max())
    assert min(apart) < 3e-4
    assert chromaticities(ColourSettings(working=space)) == PRIMARIES[space]


def test_nan_stays_in_its_pixel_and_threads_change_no_bit() -> None:
    picture = np.random.default_rng(2).uniform(-0.1, 1.2, (211, 307, 3)).astype(np.float32)
    picture[5, 7, 1] = np.nan
    try:
        for space in ("LogC3", "Canon Log 3", "sRGB"):
            results = []
            for count in (1, 2):
                set_threads(count)
                results.append(to_working(picture, space, ACESCG))
            assert np.array_equal(*results, equal_nan=True)
            missing = np.isnan(results[0]).any(axis=-1)
            assert missing[5, 7]
            assert missing.sum() == 1
            assert np.array_equal(results[0][100, 100], to_working(picture[100:101, 100:101], space, ACESCG)[0, 0])
    finally:
        set_threads()


def test_a_conversion_lets_other_threads_run() -> None:
    picture, ticks, done = np.full((1080, 1920, 3), 0.4, np.float32), [0], threading.Event()

    def tick() -> None:
        while not done.wait(0.001):
            ticks[0] += 1

    set_threads(1)
    try:
        processor = colour._between("ARRI LogC3 (EI800)", "ACEScg", ColourSettings())
        counter = threading.Thread(target=tick)
        counter.start()
        start = time.perf_counter()
        for _ in range(5):
            processor.applyRGB(picture)  # one call each: had it kept the lock, the counter would stand still
        took = time.perf_counter() - start
        done.set()
        counter.join()
        assert ticks[0] > 8 or took < 0.02
    finally:
        done.set()
        set_threads()


def test_values_outside_0_and_1_are_kept() -> None:
    for space in (*LOGS, "sRGB", "rec709"):
        out = to_working(np.array([[-0.05] * 3, [0.0] * 3, [1.0] * 3, [1.09] * 3]), space)[:, 1]
        assert (np.diff(out) > 0).all()


@pytest.mark.parametrize("space", [*GREYS, "sRGB", "rec709", "rec2020"])
def test_a_transfer_table_is_the_conversion(space: str) -> None:
    rng = np.random.default_rng(3)
    for settings in (ColourSettings(), ACESCG):
        made = transfer_table(space, settings)
        if made is None:
            assert space in ("Apple Log", "ACEScc")  # tables whose kinks no even steps can follow
            continue
        codes = rng.uniform(-0.07, 1.1, (3000, 3)).astype(np.float32)
        got = np.interp(codes, np.linspace(made.low, made.high, len(made.table)), made.table)
        got = got if made.matrix is None else got @ made.matrix.T.astype(np.float64)
        wanted = to_working(codes, space, settings)
        assert (np.abs(got - wanted) <= 1.2e-5 * np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-3)).all()
    assert transfer_table("linear") is None


def test_friendly_names() -> None:
    for name, (space, *_) in ALIASES.items():
        assert checked_space(name) == checked_space(name.lower().replace(" ", "_")) == space
    # Where the curve's name leaves the gamut open.
    assert checked_space("S-Log3") == "S-Log3 S-Gamut3.Cine"
    assert checked_space("V-Log") == "V-Log V-Gamut"
    assert checked_space("LogC") == checked_space("LogC3") == "ARRI LogC3 (EI800)"
    assert checked_space("Canon Log 3") == "CanonLog3 CinemaGamut D55"
    assert checked_space("Rec.709") == "rec709"
    assert checked_space("s-log3 s-gamut3") == "S-Log3 S-Gamut3"
    assert checked_space("scene_linear") == "ACEScg"
    for word, told in {"srbg": "'sRGB'", "LogC5": "'LogC", "Sony": "Sony - ", "ACESgc": "'ACEScg'", "zzz": STUDIO_CONFIG, "Raw": "data"}.items():
        with pytest.raises(ShotError, match="colour_space") as error:
            checked_space(word)
        assert told in str(error.value)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"working": "LogC3"}, "not scene-linear"),
        ({"working": "ACEScq"}, "did you mean 'ACEScg'"),
        ({"display": "sGRB - Display"}, "did you mean 'sRGB - Display'"),
        ({"display": "sRGB", "view": "Untonemaped"}, "did you mean 'Un-tone-mapped'"),
        ({"config": "nowhere.ocio"}, "no such file"),
        ({"config": "ocio://nope"}, "ocio://nope"),
    ],
)
def test_settings_that_cannot_be(changed: dict[str, str], told: str) -> None:
    with pytest.raises(ShotError, match=told) as error:
        check_colour(ColourSettings(**changed), "auto")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "words", "broken: [", "ocio_profile_version: 9\n", "ocio_profile_version: 2\ncolorspaces: 3\n"])
def test_a_broken_config(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.ocio").write_text(text)
    with pytest.raises(ShotError, match=r"config\.ocio") as error:
        check_colour(ColourSettings(config=str(tmp_path / "config.ocio")), "film")
    assert "\n" not in str(error.value)


def test_a_config_of_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = own_config(tmp_path)
    assert checked_space("Kodak", own) == "film"
    assert to_working(np.full((1, 3), 0.5), "film", own) == pytest.approx(0.25, abs=1e-6)
    assert chromaticities(own) == PRIMARIES["ACEScg"]  # known by its matrix
    assert rec709_from_working(to_working([[0.5, 0.2, 0.1]], "sRGB", own), own) == pytest.approx(decode([[0.5, 0.2, 0.1]], "sRGB"), abs=1e-5)
    assert to_working([[0.5, 0.2, 0.1]], "sRGB", own) == pytest.approx(to_working([[0.5, 0.2, 0.1]], "sRGB", ACESCG), abs=1e-5)
    assert working_space(replace(own, working="linear Rec.709")) == "linear Rec.709"
    assert display_picture(np.full((1, 1, 3), 0.25), replace(own, view="Film")).tolist() == [[[128] * 3]]
    for space, told in {"table": "missing.cube", "flim": "did you mean 'film'"}.items():
        with pytest.raises(ShotError, match=told):
            check_colour(own, space)
    alone = own_config(tmp_path, interchange=False)
    assert chromaticities(alone) is None
    with pytest.raises(ShotError, match="aces_interchange"):
        to_working(np.zeros((1, 3)), "sRGB", alone)
    monkeypatch.setenv("OCIO", str(tmp_path / "config.ocio"))
    assert checked_space("film", replace(alone, config="$OCIO")) == "film"
    with pytest.raises(ShotError, match="unknown"):
        checked_space("kodak")  # the environment alone is not obeyed


def test_a_digest_follows_the_config_and_its_files(tmp_path: Path) -> None:
    own = own_config(tmp_path)
    before = config_digest(own)
    (tmp_path / "luts").mkdir()
    (tmp_path / "luts" / "missing.cube").write_text("LUT_1D_SIZE 2\n0 0 0\n1 1 1\n")
    after = config_digest(own)
    (tmp_path / "luts" / "missing.cube").write_text("LUT_1D_SIZE 2\n0 0 0\n2 2 2\n")
    assert len({before, after, config_digest(own), config_digest(), config_digest(ACESCG)}) == 5
    assert config_digest(ColourSettings(), "sRGB") != config_digest(ColourSettings(), "LogC3")
    assert config_digest(replace(ACESCG, view="Raw")) == config_digest(ACESCG)


COLOURS = np.random.default_rng(5).uniform(0, 2, (4, 6, 3)).astype(np.float32)


def test_files_say_their_space_and_are_taken_at_their_word(tmp_path: Path) -> None:
    path = write_frame(tmp_path / "a.exr", Frame(passes={"beauty": COLOURS}), half=False, colour=ACESCG)
    (part,) = read_exr(path)
    assert part.metadata["stereorelight/working_space"] == "ACEScg"
    assert part.attributes["chromaticities"] == pytest.approx(PRIMARIES["ACEScg"], abs=1e-6)
    assert np.array_equal(read_frame(path, colour=ACESCG)["beauty"], COLOURS)
    assert np.array_equal(read_plate(path, colour=ACESCG), COLOURS)
    assert np.array_equal(read_plate(path, colour_space="linear"), COLOURS)
    wanted = to_working(COLOURS, "ACEScg")
    assert np.array_equal(read_frame(path)["beauty"], wanted)
    assert np.array_equal(read_plate(path), wanted)


@pytest.mark.parametrize("header", [{"chromaticities": PRIMARIES["ACES2065-1"]}, {"acesImageContainerFlag": 1}, {"colorInteropID": "lin_ap0_scene"}])
def test_files_of_others_that_state_a_space(tmp_path: Path, header: dict[str, object]) -> None:
    planes = {name: np.ascontiguousarray(COLOURS[..., i]) for i, name in enumerate("RGB")}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}, planes).write(str(tmp_path / "a.exr"))
    assert np.array_equal(read_plate(tmp_path / "a.exr"), to_working(COLOURS, "ACES2065-1"))


def test_primaries_that_no_config_knows_and_none_at_all(tmp_path: Path) -> None:
    channels = {name: COLOURS[..., i] for i, name in enumerate("RGB")}
    odd = (0.63, 0.34, 0.31, 0.595, 0.155, 0.07, 0.3127, 0.329)  # SMPTE-C
    path = write_exr(tmp_path / "odd.exr", channels, attributes={"chromaticities": odd})
    smpte_c = [[0.9395, 0.0502, 0.0103], [0.0178, 0.9658, 0.0164], [-0.0016, -0.0044, 1.0060]]  # SMPTE RP 177
    assert np.abs(read_plate(path) - COLOURS @ np.array(smpte_c).T).max() < 2e-3
    assert np.array_equal(read_plate(write_exr(tmp_path / "none.exr", channels), colour=ACESCG), COLOURS)
    path = write_exr(tmp_path / "flat.exr", channels, attributes={"chromaticities": (0.3,) * 8})
    with pytest.raises(PlateError, match="are no primaries"):
        read_plate(path)
    path = write_exr(tmp_path / "foreign.exr", channels, metadata={"stereorelight/working_space": "house linear"})
    with pytest.raises(PlateError, match="'house linear', which is unknown"):
        read_plate(path)


@pytest.mark.parametrize("code", ["01:02:03:23", "10:00:59;29", "00:00:01:59"])
def test_time_code_and_the_sources_words_travel(tmp_path: Path, code: str) -> None:
    frame = Frame(passes={"beauty": COLOURS}, metadata={"reelName": "A001", "cameraModel": "größer"})
    path = write_frame(tmp_path / "a.exr", frame, timecode=code, rate=Fraction(60000, 1001))
    read = read_frame(path)
    assert dict(read.metadata) == {"reelName": "A001", "cameraModel": "größer", "timecode": code, "rate": "60000/1001"}
    again = read_frame(write_frame(tmp_path / "b.exr", read))
    assert again.metadata == read.metadata
    if code != "00:00:01:59":
        stored = read_exr(path)[0].header
        assert stored["framesPerSecond"] == Fraction(60000, 1001)
        assert (stored["timeCode"].hours, stored["timeCode"].frame, bool(stored["timeCode"].dropFrame)) == (
            int(code[:2]),
            int(code[-2:]),
            ";" in code,
        )


def test_attributes_that_no_header_holds(tmp_path: Path) -> None:
    for bad in ({"timeCode": "soon"}, {"framesPerSecond": 0}, {"chromaticities": (1, 2)}, {"owner": 3}):
        with pytest.raises(PassError, match="attribute"):
            write_exr(tmp_path / "a.exr", {"Z": COLOURS[..., 0]}, attributes=bad)
    with pytest.raises(PassError, match="'rate'"):
        write_frame(tmp_path / "a.exr", Frame(passes={"beauty": COLOURS}, metadata={"rate": "fast"}))


def test_pictures_of_any_source_become_plates() -> None:
    assert np.array_equal(linear_plate(COLOURS, "clip.mov frame 3", colour_space="LogC3", is_float=True), to_working(COLOURS, "LogC3"))
    with pytest.raises(PlateError, match=r"clip\.mov frame 3: every pixel"):
        linear_plate(np.full((2, 2, 3), np.nan, np.float32), "clip.mov frame 3", is_float=True)


def test_a_display_view_shows_its_own_numbers() -> None:
    grey = np.full((2, 2, 3), 0.18, np.float32)
    flat = ColourSettings(display="sRGB - Display", view="Un-tone-mapped")
    assert display_picture(grey, flat).tolist() == np.full((2, 2, 3), 118).tolist()  # sRGB of 18 %: 117.65
    aces = ColourSettings(view="ACES 1.0 - SDR Video")
    assert 80 <= display_picture(grey, aces)[0, 0, 0] <= 100  # ACES 1.x puts 18 % at a tenth of display white
    assert display_picture(np.full((1, 1, 3), np.nan, np.float32), flat).max() == 0

"""The seen surface as points and triangles: cut where it ends, whole where it does not, closed behind by choice, and out as PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereorelight.camera import Camera
from stereorelight.errors import OutputError, PassError, RigError
from stereorelight.interchange.ply import write_ply
from stereorelight.surface.closing import thickness_of_matte
from stereorelight.surface.cloud import SeenBy, cloud_of, merged
from stereorelight.surface.mesh import beside_nearer, links_of, mesh_from_depth, solid
from stereorelight.surface.visibility import ShadowScene

CAMERA = Camera.from_fov(40, (96, 64))
V, U = np.mgrid[0:64, 0:96].astype(np.float64)
X, Y = (U - CAMERA.cx) / CAMERA.fx, (V - CAMERA.cy) / CAMERA.fy


def wall(distance: float = 2.0) -> np.ndarray:
    return np.full(CAMERA.size_hw, distance, np.float32)


def card() -> tuple[np.ndarray, np.ndarray]:
    """A card at 1.2 m before a wall at 2 m, and where it is."""
    on = (abs(U - 48) < 15) & (abs(V - 30) < 10)
    return np.where(on, np.float32(1.2), wall()), on


def ball(radius: float = 0.2, distance: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Exact Z of a ball, NaN beside it, and where it is."""
    a, b, c = X * X + Y * Y + 1, distance, distance**2 - radius**2
    root = b * b - a * c
    return np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, np.nan).astype(np.float32), root > 0


def floor() -> np.ndarray:
    """A floor 0.1 m below the eye: its far rows are seen at 3 degrees."""
    return np.where(Y > 0.03, 0.1 / np.maximum(Y, 1e-9), np.nan).astype(np.float32)


def area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=-1).sum() / 2)


def test_a_depth_edge_is_cut_and_nothing_else() -> None:
    Z, on = card()
    links = links_of(Z, CAMERA)
    np.testing.assert_array_equal(~links.across, on[:, 1:] != on[:, :-1])
    np.testing.assert_array_equal(~links.down, on[1:] != on[:-1])


@pytest.mark.parametrize("Z", [wall(), floor()], ids=["wall", "grazing floor"])
def test_a_surface_hangs_together_however_it_is_seen(Z: np.ndarray) -> None:
    links, known = links_of(Z, CAMERA), np.isfinite(Z)
    assert links.across[known[:, 1:] & known[:, :-1]].all()
    assert links.down[known[1:] & known[:-1]].mean() > 0.99


def test_outlines_neither_shrink_nor_grow() -> None:
    Z, on = card()
    mesh = mesh_from_depth(Z, CAMERA)
    near = (mesh.vertices[mesh.triangles][..., 2] > -1.3).all(axis=-1)
    size = on.sum() * 1.2**2 / (CAMERA.fx * CAMERA.fy)
    assert area(mesh.vertices, mesh.triangles[near]) == pytest.approx(size, rel=0.003)
    assert mesh.seen == len(mesh.triangles)


def test_triangles_face_the_camera_and_lie_on_the_surface() -> None:
    Z, _ = ball()
    mesh = mesh_from_depth(Z, CAMERA)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    turned = (np.cross(b - a, c - a) * -(a + b + c)).sum(axis=-1)
    assert (turned > 0).mean() > 0.99
    off = np.linalg.norm(mesh.vertices[mesh.triangles].mean(axis=1) - (0, 0, -1.5), axis=-1) - 0.2
    assert np.median(abs(off)) < 2e-4


def test_thickness_closes_a_sheet() -> None:
    """From inside there is no way out, whichever way one looks; a thin sheet is open behind."""
    Z, on = card()
    Z = np.where(on, Z, np.nan).astype(np.float32)
    N = np.broadcast_to(np.float32([0, 0, 1]), (*Z.shape, 3))
    ways = np.random.default_rng(0).normal(size=(2000, 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    inside = np.broadcast_to([0.0, 0.02, -1.25], ways.shape)
    outside = np.broadcast_to([0.0, 0.02, -1.35], ways.shape)
    far = np.full(len(ways), 10.0)
    solid_one, thin = (ShadowScene(Z=Z, N=N, camera=CAMERA, thickness_m=t) for t in (0.1, 0.0))
    assert solid_one.blocked(inside, ways, far).all()
    assert 0.1 < solid_one.blocked(outside, ways, far).mean() < 0.5
    assert 0.1 < thin.blocked(inside, ways, far).mean() < 0.6


def test_bad_surfaces_are_refused() -> None:
    with pytest.raises(PassError, match="no known pixel"):
        mesh_from_depth(np.full(CAMERA.size_hw, np.nan, np.float32), CAMERA)
    with pytest.raises(PassError, match="thickness"):
        mesh_from_depth(wall(), CAMERA, thickness_m=-0.1)


def test_specks_and_ground_beside_an_edge_are_told() -> None:
    Z, on = card()
    Z[5, 5] = 1.0
    links = links_of(Z, CAMERA)
    assert not solid(links)[5, 5]
    assert solid(links)[on].all()
    beside = beside_nearer(Z, links, within_px=3)
    assert not beside[on].any()
    assert beside[30, 63 : 63 + 4].all()
    assert not beside[30, 63 + 6 : -1].any()


def test_a_ball_closed_by_its_matte_is_nearly_a_ball() -> None:
    Z, on = ball()
    thick = thickness_of_matte(Z, on.astype(np.float32), CAMERA)
    assert thick[32, 48] == pytest.approx(0.4, rel=0.2)
    assert (thick[~on] == 0).all()
    assert thick[on].min() > 0
    with pytest.raises(PassError, match="matte holds no pixel"):
        thickness_of_matte(Z, np.zeros(CAMERA.size_hw, np.float32), CAMERA)


def test_a_cloud_holds_the_known_points() -> None:
    Z, on = ball()
    sure = np.where(V < 30, 0.2, 0.9).astype(np.float32)
    cloud = cloud_of(SeenBy(Z=Z, camera=CAMERA, confidence=sure), least_confidence=0.5)
    assert len(cloud) == (on & (V >= 30)).sum()
    np.testing.assert_allclose(np.linalg.norm(cloud.points - (0, 0, -1.5), axis=-1), 0.2, atol=1e-5)
    with pytest.raises(PassError, match=r"no known point of confidence 0\.95"):
        cloud_of(SeenBy(Z=Z, camera=CAMERA, confidence=sure), least_confidence=0.95)


def test_two_eyes_are_one_cloud() -> None:
    """A wall whose left and right depths are off to either side by their sigma comes out in the middle; what the card hides is filled."""
    baseline = 0.2
    pose = np.eye(4)
    pose[0, 3] = baseline
    Z, on = card()
    shift = round(CAMERA.fx * baseline * (1 / 1.2 - 1 / 2.0))
    # The right eye sees the card further left before the same wall.
    right_on = np.roll(on, -round(CAMERA.fx * baseline / 1.2), axis=1)
    right = np.where(right_on, np.float32(1.2), wall(2.004))
    left = np.where(on, Z, np.float32(1.996))
    sigma = np.full(CAMERA.size_hw, 0.004, np.float32)
    alone = cloud_of(SeenBy(Z=left, camera=CAMERA))
    cloud = merged(SeenBy(Z=left, camera=CAMERA, Z_sigma=sigma), SeenBy(Z=right, camera=CAMERA, Z_sigma=sigma), pose)
    assert len(cloud) > len(alone) + 0.5 * shift * 19  # the strip behind the card that only the right eye sees
    z = -cloud.points[: len(alone), 2].reshape(CAMERA.size_hw)
    seen_by_both = ~on & (U > 40) & (V > 45)
    assert np.median(z[seen_by_both]) == pytest.approx(2.0, abs=5e-4)
    with pytest.raises(RigError, match="rotation"):
        merged(SeenBy(Z=left, camera=CAMERA), SeenBy(Z=right, camera=CAMERA), 2 * np.eye(4))


def test_ply_holds_what_was_given(tmp_path: Path) -> None:
    points = np.array([[0, 0, -1], [1, 0, -1], [0, 1, -2]], np.float32)
    colours = np.array([[0, 0.5, 1], [1, 1, 1], [2, -1, 0]])
    path = write_ply(tmp_path / "a.ply", points, colours=colours, confidence=np.array([0.1, 0.2, 0.3]), triangles=np.array([[0, 1, 2]]))
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode().split("\n")
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "element vertex 3" in lines
    assert "element face 1" in lines
    vertices = np.frombuffer(body, [("p", "<f4", 3), ("c", "u1", 3), ("s", "<f4")], count=3)
    np.testing.assert_array_equal(vertices["p"], points)
    np.testing.assert_array_equal(vertices["c"], [[0, 128, 255], [255, 255, 255], [255, 0, 0]])
    np.testing.assert_allclose(vertices["s"], [0.1, 0.2, 0.3])
    assert body[3 * 19 :] == b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    with pytest.raises(OutputError, match="exists"):
        write_ply(path, points)
    with pytest.raises(OutputError, match="names point 3"):
        write_ply(tmp_path / "b.ply", points, triangles=np.array([[0, 1, 3]]))
    with pytest.raises(OutputError, match="NaN"):
        write_ply(tmp_path / "b.ply", points * np.nan)
    assert not (tmp_path / "b.ply").exists()

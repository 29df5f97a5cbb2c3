"""Which pixels become points, and cloud.ply as other programs read it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from acquire.contract.calibration import CameraModel, TranslatingPlane
from acquire.contract.errors import ScanFileError
from process.cloud.cloud import PointCloud, make_cloud
from process.cloud.light_planes import plane_table
from process.cloud.ply import VERTEX, read_vertices, write_ply
from process.cloud.triangulation import rays
from tests.needs import OPEN3D, need, need_module

CAMERA = CameraModel(
    width=4,
    height=3,
    K=((1.0, 0.0, 1.5), (0.0, 1.0, 1.0), (0.0, 0.0, 1.0)),
    R=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    T=(0.0, 0.0, 0.0),
)
PLANE = TranslatingPlane("frame", (0.0, 0.0, 1.0), (0.0, 0.0, 10.0), (0.0, 0.0, 1.0))
FRAME_T = np.arange(1, 11, dtype=np.float64)


def maps(crossing=3.0, quality=0) -> SimpleNamespace:
    colour = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    return SimpleNamespace(
        crossing=np.full((3, 4), crossing),
        sigma=np.full((3, 4), 0.25, np.float32),
        quality=np.full((3, 4), quality, np.uint16),
        colour=colour,
    )


def cloud_of(found, **options) -> PointCloud:
    return make_cloud(found, rays(CAMERA), plane_table(PLANE), FRAME_T, **options)


def random_cloud(count: int) -> PointCloud:
    rng = np.random.default_rng(5)
    return PointCloud(
        points_mm=rng.normal(size=(count, 3)),
        rgb=rng.integers(0, 256, (count, 3)).astype(np.uint8),
        sigma_um=rng.random(count).astype(np.float32),
        crossing=rng.uniform(0, 500, count),
        quality=rng.integers(0, 64, count).astype(np.uint16),
        pixels=np.arange(count),
    )


def test_points_stand_in_row_major_order_with_the_colour_of_their_pixel():
    found = maps()
    found.crossing[1, 2] = np.nan
    cloud = cloud_of(found)
    assert cloud.pixels.tolist() == [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11]
    assert cloud.rgb[6].tolist() == found.colour[1, 3].tolist()
    assert np.allclose(cloud.points_mm[:, 2], 14.0), "t = 3 + 1"
    assert np.allclose(cloud.points_mm[0], [14.0 * -1.5, 14.0 * -1.0, 14.0])


@pytest.mark.parametrize("bit", [1, 2, 128])
def test_pixels_without_a_trustworthy_edge_are_left_out_unless_asked_for(bit):
    found = maps(quality=4 | 8 | 16 | 32 | 64)
    found.quality[0, 0] |= bit
    assert 0 not in cloud_of(found).pixels
    assert len(cloud_of(found)) == 11
    assert len(cloud_of(found, left_out=0)) == 12


def test_sigma_in_um_is_the_frames_times_the_way_per_frame():
    cloud = cloud_of(maps())
    middle_mm_per_frame = np.linalg.norm(cloud.points_mm[0]) / 14.0
    assert cloud.sigma_um[0] == pytest.approx(0.25 * middle_mm_per_frame * 1000, rel=1e-6)


def test_no_crossings_give_an_empty_cloud_that_can_still_be_written(tmp_path):
    cloud = cloud_of(maps(crossing=np.nan))
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    assert len(PlyData.read(str(tmp_path / "cloud.ply"))["vertex"]) == 0


def test_the_same_cloud_gives_the_same_bytes(tmp_path):
    for name in ("a.ply", "b.ply"):
        write_ply(tmp_path / name, random_cloud(100).vertices())
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_the_file_holds_every_field_in_the_documented_order(tmp_path):
    cloud = random_cloud(50)
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    ply = PlyData.read(str(tmp_path / "cloud.ply"))
    assert ply.byte_order == "<" and not ply.text
    assert tuple(prop.name for prop in ply["vertex"].properties) == VERTEX.names
    assert np.array_equal(ply["vertex"].data, cloud.vertices())
    assert np.array_equal(ply["vertex"]["x"], cloud.xyz[:, 0])


def test_trimesh_opens_the_file_with_the_same_points_and_colours(tmp_path):
    import trimesh

    cloud = random_cloud(321)
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    found = trimesh.load(tmp_path / "cloud.ply")
    assert np.allclose(found.vertices, cloud.xyz)
    assert np.array_equal(found.colors[:, :3], cloud.rgb)


def test_open3d_opens_the_file_with_points_colours_sigma_and_crossing(tmp_path):
    need(*OPEN3D)
    import open3d as o3d

    cloud = random_cloud(321)
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    found = o3d.t.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    assert np.array_equal(found.point.positions.numpy(), cloud.xyz)
    assert np.array_equal(found.point.colors.numpy(), cloud.rgb)
    assert np.array_equal(found.point["quality"].numpy().ravel(), cloud.quality)
    assert np.array_equal(found.point["sigma_um"].numpy().ravel(), cloud.sigma_um)
    assert np.array_equal(found.point["crossing"].numpy().ravel(), cloud.crossing.astype(np.float32))


def test_meshio_opens_the_file_with_every_column(tmp_path):
    meshio = need_module("meshio")
    cloud = random_cloud(321)
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    found = meshio.read(tmp_path / "cloud.ply")
    assert np.array_equal(found.points, cloud.xyz)
    for name in ("sigma_um", "crossing", "quality"):
        assert np.array_equal(found.point_data[name], cloud.vertices()[name])
    # its uchar is signed
    assert np.array_equal(found.point_data["red"].astype(np.uint8), cloud.rgb[:, 0])


def test_a_cloud_of_the_version_before_is_read_by_ours(tmp_path):
    old = np.dtype([*((name, VERTEX[name].str) for name in VERTEX.names[:-1]), ("quality", "<u2")])
    vertices = random_cloud(50).vertices().astype(old)
    PlyData([PlyElement.describe(vertices, "vertex")], byte_order="<").write(str(tmp_path / "cloud.ply"))
    found = read_vertices(tmp_path / "cloud.ply", instead="")
    assert found.dtype == old and np.array_equal(found, vertices)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_cloud_that_others_have_written_again_is_read(tmp_path, order):
    vertices = random_cloud(50).vertices()
    faces = np.array([([0, 1, 2],)], dtype=[("vertex_indices", "i4", (3,))])
    parts = [PlyElement.describe(vertices, "vertex", comments=["of ours"]), PlyElement.describe(faces, "face")]
    PlyData(parts, byte_order=order, comments=["made anew"]).write(str(tmp_path / "cloud.ply"))
    found = read_vertices(tmp_path / "cloud.ply", instead="")
    assert all(np.array_equal(found[name], vertices[name]) for name in VERTEX.names)


def test_a_cloud_as_text_or_cut_short_is_refused_in_one_line(tmp_path):
    path = tmp_path / "cloud.ply"
    PlyData([PlyElement.describe(random_cloud(5).vertices(), "vertex")], text=True).write(str(path))
    with pytest.raises(ScanFileError, match="no binary PLY; do it again"):
        read_vertices(path, instead="do it again")
    write_ply(path, random_cloud(5).vertices())
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ScanFileError, match="cut short: its header promises 5 points"):
        read_vertices(path, instead="")
    for content in (
        b"",
        b"ply\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 5",
        b"ply\n" + b"\n" * 100_000,
    ):
        path.write_bytes(content)
        with pytest.raises(ScanFileError):
            read_vertices(path, instead="")
    with pytest.raises(ScanFileError, match="No such file"):
        read_vertices(tmp_path / "nothing.ply", instead="")


def test_pymeshlab_opens_the_file_with_the_same_points_and_colours(tmp_path):
    need("libopengl0")
    import pymeshlab

    cloud = random_cloud(321)
    write_ply(tmp_path / "cloud.ply", cloud.vertices())
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "cloud.ply"))
    found = meshes.current_mesh()
    assert np.allclose(found.vertex_matrix(), cloud.xyz)
    assert np.array_equal(np.rint(found.vertex_color_matrix()[:, :3] * 255), cloud.rgb)

"""The z-buffer against Embree, and what can be worked out by hand."""

import manifold3d as m3
import numpy as np
import pytest
import trimesh

from composenet.geometry.transform import inverse_T, make_T, rotation_z
from composenet.records import Camera, Symmetry
from composenet.synth import render, shading
from composenet.synth.shape import Material, Shape, ShapeBuilder

CAMERA = Camera(np.array([[280.0, 0, 160.3], [0, 275.0, 118.9], [0, 0, 1]]), 320, 240)


def solid(part: m3.Manifold, pattern: str = "plain") -> Shape:
    builder = ShapeBuilder()
    builder.add(part, Material((0.8, 0.4, 0.2), pattern, 0.1, 0.3))
    return builder.build("clutter", "test", Symmetry.NONE)


def embree(mesh: render.Mesh, T: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(depth, face) by casting the ray of every pixel centre."""
    points = np.stack(
        [
            T[i, :3, :3] @ p + T[i, :3, 3]
            for i, p in zip(mesh.vertex_instance, mesh.vertices.astype(float), strict=True)
        ]
    )
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    K = camera.K
    rays = np.stack(
        [(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1
    ).reshape(-1, 3)
    scene = trimesh.Trimesh(points, mesh.faces, process=False)
    ray = trimesh.ray.ray_pyembree.RayMeshIntersector(scene)
    origins = rays * render.NEAR_M  # everything before the near plane is cut away
    hit_points, hit_ray, hit_face = ray.intersects_location(origins, rays, multiple_hits=False)
    depth = np.zeros(len(rays))
    face = np.full(len(rays), -1)
    depth[hit_ray], face[hit_ray] = hit_points[:, 2], hit_face
    return depth.reshape(u.shape), face.reshape(u.shape)


def test_equals_embree_on_random_solids() -> None:
    pytest.importorskip("embreex")
    rng = np.random.default_rng(0)
    shapes, poses = [], []
    for k in range(25):
        if k % 2:
            shapes.append(solid(m3.Manifold.cube(list(rng.uniform(0.1, 1.0, 3)))))
        else:
            shapes.append(solid(m3.Manifold.sphere(float(rng.uniform(0.2, 0.6)), 24)))
        turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
        # Some reach behind the camera.
        poses.append(make_T(turn, [rng.uniform(-2, 2), rng.uniform(-1.5, 1.5), rng.uniform(0, 5)]))
    shapes.append(solid(m3.Manifold.cube([12, 0.1, 12])))
    poses.append(make_T(np.eye(3), [0, 1.2, 3]))
    mesh, T = render.assemble(shapes), np.array(poses)
    ours = render.draw(mesh, T, CAMERA)
    depth, face = embree(mesh, T, CAMERA)
    same = np.isclose(ours.depth_m, depth, atol=1e-3)
    assert same.mean() > 0.9995
    assert (ours.face == face).mean() > 0.995  # edges shared by two faces may go to either
    assert (ours.depth_m > 0).mean() > 0.5


def test_depth_of_a_wall_is_its_distance() -> None:
    mesh = render.assemble([solid(m3.Manifold.cube([50, 50, 2]))])
    buffers = render.draw(mesh, make_T(np.eye(3), [0, 0, 5])[None], CAMERA)
    np.testing.assert_allclose(buffers.depth_m, 4.0, rtol=1e-6)
    surface = render.surface(mesh, buffers, CAMERA)
    assert surface[119, 160, 0] == pytest.approx(1.0, abs=1e-4)
    assert surface[0, 0, 0] < 0.9
    np.testing.assert_allclose(surface[..., 2], 0.3, rtol=1e-6)


def test_pixel_centres() -> None:
    """A square of 10 px seen at z = 1 covers the pixels whose centres lie inside."""
    K = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])
    mesh = render.assemble([solid(m3.Manifold.cube([0.1, 0.1, 0.02]))])
    # Its near face spans u, v in [45.2, 55.2].
    pose = make_T(np.eye(3), [0.002, 0.002, 1.01])
    ids = render.draw(mesh, pose[None], Camera(K, 101, 101)).face >= 0
    rows, columns = np.nonzero(ids)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (46, 55, 46, 55)


def test_inside_a_box_every_ray_hits() -> None:
    """Faces are drawn from behind and cut at the near plane."""
    mesh = render.assemble([solid(m3.Manifold.cube([2, 2, 2]))])
    buffers = render.draw(mesh, np.eye(4)[None], CAMERA)
    assert (buffers.face >= 0).all()
    assert buffers.depth_m.max() <= 1.0 + 1e-6


def test_nearer_object_hides() -> None:
    cube = solid(m3.Manifold.cube([0.5, 0.5, 0.5]))
    mesh = render.assemble([cube, cube])
    poses = np.stack([make_T(np.eye(3), [0, 0, z]) for z in (3.0, 2.0)])
    buffers = render.draw(mesh, poses, CAMERA)
    assert set(mesh.face_instance[buffers.face[buffers.face >= 0]]) == {1}


def test_silhouette_counts_what_leaves_the_image() -> None:
    cube = solid(m3.Manifold.cube([0.5, 0.5, 0.5]))
    mesh = render.assemble([cube])
    inside = render.draw(mesh, make_T(np.eye(3), [0, 0, 3])[None], CAMERA)
    whole = render.silhouette_pixels(inside.points_camera, cube.faces, CAMERA)
    assert whole == np.count_nonzero(inside.face >= 0)
    # Centred on the left border: half of it is seen.
    panel = solid(m3.Manifold.cube([0.5, 0.5, 0.002]))
    x = -(CAMERA.K[0, 2] + 0.5) / CAMERA.K[0, 0] * 3
    edge = render.draw(render.assemble([panel]), make_T(np.eye(3), [x, 0, 3])[None], CAMERA)
    seen = np.count_nonzero(edge.face >= 0)
    whole = render.silhouette_pixels(edge.points_camera, panel.faces, CAMERA)
    assert seen / whole == pytest.approx(0.5, abs=0.03)
    behind = render.draw(mesh, make_T(np.eye(3), [0, 0, -3])[None], CAMERA)
    assert render.silhouette_pixels(behind.points_camera, cube.faces, CAMERA) == 0


def test_patterns_move_with_the_object() -> None:
    """Turning camera, lights and object together changes no pixel."""
    mesh = render.assemble([solid(m3.Manifold.cube([1, 1, 1]), "checker")])
    T_world_camera = np.eye(4)
    T_world_object = make_T(rotation_z(0.3), [0.1, 0.0, 2.5])
    light = shading.Light(np.array([0.0, -0.6, -0.8]), np.array([1.0, -1.0, 0.5]))
    images = []
    for move in (np.eye(4), make_T(rotation_z(1.1), [3.0, -2.0, 0.0])):
        pose, camera = move @ T_world_object, move @ T_world_camera
        T = (inverse_T(camera) @ pose)[None]
        turned = shading.Light(move[:3, :3] @ light.sun, move[:3, :3] @ light.lamp + move[:3, 3])
        buffers = render.draw(mesh, T, CAMERA)
        images.append(shading.shade(mesh, buffers, T, camera, CAMERA, turned))
    difference = np.abs(images[0].astype(int) - images[1]).max(axis=2)
    # The ambient light comes from above in the world, which both share here.
    assert np.mean(difference > 2) < 0.002
    assert len(np.unique(images[0].reshape(-1, 3), axis=0)) > 20

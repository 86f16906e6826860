"""Scenes with ground truth: touching without penetration, right images, repeatable."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from inhand.camera import Camera
from inhand.errors import InputError
from inhand.geometry import se3
from inhand.geometry.mesh import TriangleMesh, box, concatenate, transformed
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.synth import demo
from inhand.synth.grasp import Grasp, GraspSampler, open_configuration
from inhand.synth.scene import (
    BACKGROUND,
    HAND,
    NOISY,
    NOTHING,
    OBJECT,
    Scene,
    SceneMaker,
    SceneProtocol,
    make_scene,
)

SMALL = Camera(fx=150, fy=150, cx=79.5, cy=59.5, width=160, height=120)
PENETRATION = 0.0007  # voxel fields round sharp edges


@pytest.fixture(scope="module")
def two_link_gripper(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """A parallel gripper whose second jaw mimics the first, as prismatic joints."""

    def jaw(side: int) -> str:
        mimic = '<mimic joint="jaw_1"/>' if side < 0 else ""
        return f"""<link name="finger_{side}"><visual><origin xyz="0 0 0.04"/>
            <geometry><box size="0.01 0.02 0.08"/></geometry></visual></link>
          <joint name="jaw_{side}" type="prismatic"><parent link="palm"/>
            <child link="finger_{side}"/><origin xyz="{side * 0.05} 0 0.02"/>
            <axis xyz="{-side} 0 0"/><limit lower="0" upper="0.045" effort="1" velocity="1"/>{mimic}
          </joint>"""

    path = tmp_path_factory.mktemp("gripper") / "gripper.urdf"
    path.write_text(
        f"""<robot name="gripper"><link name="palm"><visual>
          <geometry><box size="0.14 0.06 0.03"/></geometry></visual></link>
          {jaw(1)}{jaw(-1)}</robot>"""
    )
    return Hand.from_urdf(path)


def posed_meshes(scene: Scene) -> list[TriangleMesh]:
    """Hand links and object in the camera frame."""
    q = scene.hand.joint_vector(scene.joint_positions)
    poses = scene.T_camera_hand @ scene.hand.forward_kinematics(q)
    links = [transformed(k.mesh, T) for k, T in zip(scene.hand.links, poses, strict=True)]
    return [*links, transformed(scene.obj.mesh, scene.T_camera_object)]


def exact_gap(scene: Scene, links: tuple[int, ...]) -> float:
    """Smallest distance of some links' samples to the object [m], negative inside, by trimesh."""
    q = scene.hand.joint_vector(scene.joint_positions)
    poses = scene.T_camera_hand @ scene.hand.forward_kinematics(q)
    obj = trimesh.Trimesh(scene.obj.mesh.vertices, scene.obj.mesh.faces, process=False)
    T_object_camera = se3.inverse(scene.T_camera_object)
    gaps = []
    for i in links:
        points = se3.transform(T_object_camera @ poses[i], scene.hand.links[i].surface.points)
        near = points[scene.obj.distance_field.distance(points) < 0.01]
        if len(near):
            gaps.append(-trimesh.proximity.signed_distance(obj, near).max())
    return min(gaps, default=np.inf)


def test_fixed_scenes_touch_with_every_finger_and_do_not_penetrate(scenes: list[Scene]) -> None:
    for scene in [*scenes, demo.demo_scene()]:
        for finger in scene.hand.fingers:
            gap = exact_gap(scene, finger.links)
            # Samples of the finger are some millimetres apart, so contact can lie between them.
            assert -PENETRATION < gap < 0.004, (scene.obj.name, finger.name, gap)
        assert exact_gap(scene, scene.hand.palm_links) > -PENETRATION


@pytest.mark.parametrize("name", ["cuboid", "can"])
def test_sampled_grasps_touch_and_do_not_penetrate(name: str) -> None:
    hand, obj = demo.builtin_hand(), demo.builtin_object(name)
    scene = make_scene(hand, obj, SMALL, seed=3)
    for finger in hand.fingers:
        assert -PENETRATION < exact_gap(scene, finger.links) < 0.004
    assert exact_gap(scene, hand.palm_links) > -PENETRATION


def test_fingers_do_not_run_into_each_other() -> None:
    hand, obj = demo.builtin_hand(), demo.builtin_object("cylinder")
    sampler = GraspSampler(hand, obj)
    one, two = (finger.links for finger in hand.fingers)
    for seed in range(3):
        grasp = sampler.sample(np.random.default_rng(seed))
        poses = hand.forward_kinematics(grasp.q)
        for a in one:
            for b in two:
                T_b_a = se3.inverse(poses[b]) @ poses[a]
                points = se3.transform(T_b_a, hand.links[a].surface.points)
                assert hand.links[b].distance_field.distance(points).min() > -0.0015


def test_depth_and_labels_match_an_independent_ray_caster() -> None:
    protocol = SceneProtocol(distance=(0.35, 0.5), visible=(0.4, 1.0))
    scene = make_scene(demo.builtin_hand(), demo.builtin_object("bottle"), SMALL, 1, protocol)
    meshes = posed_meshes(scene)
    everything = concatenate(meshes)
    owner = np.repeat(np.arange(len(meshes)), [len(m.faces) for m in meshes])
    v, u = np.indices(scene.depth.shape)
    rays = np.stack([(u - SMALL.cx) / SMALL.fx, (v - SMALL.cy) / SMALL.fy, np.ones(u.shape)], -1)
    rays = rays.reshape(-1, 3)
    # Millimetres: the ray caster's tolerances are absolute.
    caster = trimesh.Trimesh(everything.vertices * 1000, everything.faces, process=False).ray
    hits, ray, face = caster.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
    depth = np.zeros(len(rays))
    depth[ray] = hits[:, 2] / 1000
    label = np.full(len(rays), NOTHING)
    label[ray] = np.where(owner[face] == len(meshes) - 1, OBJECT, HAND)
    assert (np.abs(depth - scene.depth.ravel()) < 1e-4).mean() > 0.998
    assert (label == scene.label.ravel()).mean() > 0.998


def test_labels_agree_with_the_depth_image(scenes: list[Scene]) -> None:
    for scene in scenes:
        assert scene.depth.dtype == np.float32
        assert (scene.depth[scene.label == NOTHING] == 0).all()
        shown = scene.label == OBJECT
        assert np.count_nonzero(shown) > 1000
        readings = scene.depth[shown & (scene.depth > 0)]
        centre = se3.transform(scene.T_camera_object, scene.obj.centre[None])[0, 2]
        assert abs(np.median(readings) - centre) < scene.obj.diameter / 2
        behind = scene.depth[(scene.label == BACKGROUND) & (scene.depth > 0)]
        assert len(behind) == 0 or np.median(behind) > np.median(readings)


def test_visible_share_counts_what_the_hand_hides(scenes: list[Scene]) -> None:
    scene = scenes[0]
    everything_moved_away = replace(
        scene.hand,
        links=tuple(replace(k, mesh=box([1e-6, 1e-6, 1e-6])) for k in scene.hand.links),
    )
    fixed = demo.REGRESSION[0]
    bare = SceneMaker(everything_moved_away, scene.obj, scene.camera).render(
        Grasp(se3.exp(np.array(fixed.hand_object)), np.array(fixed.q)),
        scene.T_camera_hand,
        np.random.default_rng(0),
    )
    assert bare.visible_share > 0.999
    hidden = np.count_nonzero(scene.label == OBJECT) / np.count_nonzero(bare.label == OBJECT)
    assert scene.visible_share == pytest.approx(hidden, abs=1e-3)


def test_the_fixed_scenes_cover_objects_noise_and_visibility(scenes: list[Scene]) -> None:
    assert {fixed.object_name for fixed in demo.REGRESSION} == set(demo.OBJECTS)
    shares = [scene.visible_share for scene in scenes]
    assert min(shares) < 0.5 < 0.95 < max(shares)
    noisy = [fixed.protocol is NOISY for fixed in demo.REGRESSION]
    assert sum(noisy) == 4


def test_demo_scene_is_clear_but_occluded_and_noisy() -> None:
    scene = demo.demo_scene()
    assert 0.6 < scene.visible_share < 0.9
    assert np.count_nonzero(scene.label == OBJECT) > 4000
    error = se3.inverse(scene.T_camera_hand) @ scene.T_camera_hand_given
    assert 0.001 < np.linalg.norm(error[:3, 3]) < 0.02
    assert np.radians(0.3) < se3.rotation_angle(error[:3, :3], np.eye(3)) < np.radians(6)
    np.testing.assert_array_equal(scene.depth, demo.demo_scene().depth)


def test_a_seed_makes_a_scene_repeatable() -> None:
    hand, obj = demo.builtin_hand(), demo.builtin_object("cylinder")
    one, same, other = (make_scene(hand, obj, SMALL, seed, NOISY) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.depth, same.depth)
    np.testing.assert_array_equal(one.T_camera_hand_given, same.T_camera_hand_given)
    assert one.joint_positions == same.joint_positions
    assert one.joint_positions != other.joint_positions


def test_the_protocol_is_kept() -> None:
    hand, obj = demo.builtin_hand(), demo.builtin_object("can")
    protocol = replace(NOISY, distance=(0.5, 0.6), visible=(0.3, 0.7))
    scene = make_scene(hand, obj, SMALL, 2, protocol)
    centre = se3.transform(scene.T_camera_hand, hand.reach[0][None])[0]
    assert 0.4 < np.linalg.norm(centre) < 0.7
    assert 0.3 <= scene.visible_share <= 0.7
    assert np.count_nonzero(scene.label == BACKGROUND) > 0


def test_a_mimic_gripper_holds_an_object(two_link_gripper: Hand) -> None:
    open_q = open_configuration(two_link_gripper, np.random.default_rng(0))
    np.testing.assert_allclose(open_q, [0.0])
    obj = ObjectModel.from_mesh(box([0.03, 0.03, 0.05]))
    scene = make_scene(two_link_gripper, obj, SMALL, 0)
    assert scene.joint_positions["jaw_-1"] == pytest.approx(scene.joint_positions["jaw_1"])
    gap = exact_gap(scene, two_link_gripper.fingers[0].links)
    assert -PENETRATION < gap < 0.006


def test_a_three_finger_hand_holds_an_object(shared_data: Path) -> None:
    hand = Hand.from_urdf(shared_data / "hands" / "robotiq" / "robotiq_3f.urdf")
    scene = make_scene(hand, demo.builtin_object("can"), SMALL, 0)
    for finger in hand.fingers:
        assert -0.0015 < exact_gap(scene, finger.links) < 0.006


def test_an_object_too_large_for_the_hand_is_reported(two_link_gripper: Hand) -> None:
    ball = ObjectModel.from_mesh(trimesh.creation.icosphere(subdivisions=2, radius=0.2))
    with pytest.raises(InputError, match="does it fit between the fingers"):
        GraspSampler(two_link_gripper, ball).sample(np.random.default_rng(0))


def test_an_impossible_view_is_reported() -> None:
    protocol = SceneProtocol(distance=(20.0, 20.0))
    with pytest.raises(InputError, match="bring the camera closer"):
        make_scene(demo.builtin_hand(), demo.builtin_object("cuboid"), SMALL, 0, protocol)

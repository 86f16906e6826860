"""The tracker: follows, says what it does not know, notices that it is lost, and recovers."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from inhand import Camera, InputError, ObjectModel, PoseEstimate, PoseTracker, TrackerConfig
from inhand.estimate import Candidate
from inhand.evaluation.metrics import adi, sample_model
from inhand.geometry import se3
from inhand.geometry.se3 import rotation_angle, transform
from inhand.synth.demo import builtin_hand, builtin_object
from inhand.synth.grasp import Grasp
from inhand.synth.motion import MotionProtocol
from inhand.synth.scene import NOISY, OBJECT, Scene, SceneMaker, with_errors
from inhand.synth.sequence import Sequence, SequenceMaker
from inhand.tracking.config import RivalConfig

CAMERA = Camera(fx=400, fy=400, cx=207.5, cy=155.5, width=416, height=312)
PROTOCOL = replace(NOISY, distance=(0.4, 0.5), visible=(0.6, 1.0), backdrop=(0.2, 0.4))
STILL = MotionProtocol(rest=1.0, occluders=0.0, dropped=0.0)
MOVING = MotionProtocol(occluders=0.0, rest=0.1)

Change = Callable[[int, np.ndarray], np.ndarray]


class Film:
    """A sequence that a tracker may be shown, rendered once."""

    def __init__(self, name: str, motion: MotionProtocol, number: int, seed: int) -> None:
        self.hand, self.obj = builtin_hand(), builtin_object(name)
        self.makes = SceneMaker(self.hand, self.obj, CAMERA, PROTOCOL)
        maker = SequenceMaker(self.makes, motion)
        self.sequence: Sequence = maker.plan(number, np.random.default_rng(seed))
        self.scenes: list[Scene] = [
            maker.render(self.sequence, i, np.random.default_rng([seed, i])) for i in range(number)
        ]
        self.tree = KDTree(sample_model(self.obj.mesh))

    def tracker(self, config: TrackerConfig | None = None) -> PoseTracker:
        return PoseTracker(self.hand, self.obj, config, device="cpu")

    def show(self, tracker: PoseTracker, i: int, depth: np.ndarray | None = None) -> PoseEstimate:
        scene = self.scenes[i]
        return tracker.update(
            scene.depth if depth is None else depth,
            CAMERA,
            scene.T_camera_hand_given,
            time=float(self.sequence.times[i]),
        )

    def error(self, e: PoseEstimate, i: int) -> float:
        """ADI [m]."""
        assert e.T_camera_object is not None, e.reason
        return adi(self.tree, e.T_camera_object, self.scenes[i].T_camera_object)


@pytest.fixture(scope="module")
def moving() -> Film:
    return Film("industrial_part", MOVING, 30, seed=4)


@pytest.fixture(scope="module")
def still() -> Film:
    return Film("cuboid", STILL, 30, seed=2)


@pytest.fixture(scope="module")
def followed(moving: Film) -> list[PoseEstimate]:
    tracker = moving.tracker()
    return [moving.show(tracker, i) for i in range(30)]


def test_it_follows_object_wrist_and_fingers(moving: Film, followed: list[PoseEstimate]) -> None:
    truth = moving.sequence.T_hand_object
    assert np.linalg.norm(np.ptp(truth[:, :3, 3], axis=0)) > 0.005, "the object moves"
    for i, e in enumerate(followed):
        assert e.found, f"image {i}: {e.reason}"
        assert moving.error(e, i) < 0.003
        scene = moving.scenes[i]
        assert e.T_camera_hand is not None
        wrist = e.T_camera_hand[:3, 3] - scene.T_camera_hand[:3, 3]
        assert np.linalg.norm(wrist) < 0.004
    errors = [
        abs(e.joint_positions[name] - scene.joint_positions[name])
        for e, scene in zip(followed, moving.scenes, strict=True)
        for name in e.joint_positions
    ]
    assert np.median(errors) < np.radians(2)


def test_only_the_first_image_is_searched(followed: list[PoseEstimate]) -> None:
    assert "hypotheses" in followed[0].timings
    assert not any("hypotheses" in e.timings for e in followed[1:])


def test_every_answer_has_a_sound_covariance(followed: list[PoseEstimate]) -> None:
    for e in followed:
        assert e.covariance is not None
        assert e.covariance.shape == (6, 6)
        np.testing.assert_allclose(e.covariance, e.covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(e.covariance).min() > 0
    sd = np.sqrt([np.diag(e.covariance) for e in followed[3:] if e.covariance is not None])
    assert (sd[:, :3] < np.radians(6)).all()
    assert (sd[:, 3:] < 0.01).all()


def test_where_the_meshs_origin_lies_changes_nothing(
    moving: Film, followed: list[PoseEstimate], tmp_path: Path
) -> None:
    """Not even what is known of a point: the covariance speaks of the frame's own origin."""
    away = np.array([0.08, -0.06, 0.12])
    mesh, path = moving.obj.mesh, tmp_path / "moved.obj"
    lines = ["v {} {} {}".format(*vertex) for vertex in (mesh.vertices + away).tolist()]
    lines += ["f {} {} {}".format(*face) for face in mesh.faces + 1]
    path.write_text("\n".join(lines))
    tracker = PoseTracker(moving.hand, ObjectModel.from_mesh(path), device="cpu")
    for i in range(4):
        e, usual = moving.show(tracker, i), followed[i]
        assert e.T_camera_object is not None
        assert usual.T_camera_object is not None
        assert e.covariance is not None
        assert usual.covariance is not None
        R = usual.T_camera_object[:3, :3]
        back = e.T_camera_object[:3, 3] + R @ away
        assert np.linalg.norm(back - usual.T_camera_object[:3, 3]) < 0.0005
        J = np.eye(6)  # from a twist about one origin to the motion of the other
        J[3:, :3] = se3.skew(R @ away)
        expected = J @ usual.covariance @ J.T
        np.testing.assert_allclose(e.covariance, expected, atol=0.05 * np.abs(expected).max())
        far, near = np.trace(e.covariance[3:, 3:]), np.trace(usual.covariance[3:, 3:])
        assert far > 1.5 * near


def test_the_same_images_give_the_same_answers(moving: Film, followed: list[PoseEstimate]) -> None:
    tracker = moving.tracker()
    for i in range(4):
        moving.show(tracker, i)
    tracker.reset()
    for i in range(6):
        again = moving.show(tracker, i)
        np.testing.assert_array_equal(again.T_camera_object, followed[i].T_camera_object)
        assert again.joint_positions == followed[i].joint_positions


def test_a_still_object_does_not_jitter(still: Film) -> None:
    tracker = still.tracker()
    answers = [still.show(tracker, i) for i in range(30)][5:]
    poses = np.stack([e.T_camera_object for e in answers if e.T_camera_object is not None])
    assert len(poses) == 25
    places = np.stack([transform(T, still.obj.centre[None])[0] for T in poses])
    assert np.sqrt(places.var(axis=0).mean()) < 0.0003
    turns = rotation_angle(poses[:, :3, :3], poses[[12], :3, :3])
    assert np.sqrt((turns**2).mean() / 3) < np.radians(0.3)


def test_a_round_body_at_rest_is_not_turned_by_noise() -> None:
    """While the estimate averages images that hardly show how it is turned."""
    film = Film("ellipsoid", STILL, 26, seed=2)
    tracker, answers, estimates = film.tracker(), [], []
    for i in range(26):
        e = film.show(tracker, i)
        assert e.T_camera_object is not None
        assert tracker._track is not None
        answers.append(e.T_camera_object)
        estimates.append(tracker._track.T_camera_object)
    answered, estimated = (turn_sd(np.stack(poses[6:])) for poses in (answers, estimates))
    assert answered < np.radians(0.3)
    assert estimated > 2 * answered


def turn_sd(poses: np.ndarray) -> float:
    """Sd of a turn [rad] about each axis, of poses (n, 4, 4)."""
    turns = Rotation.from_matrix(poses[:, :3, :3])
    return float(np.sqrt((turns * turns.mean().inv()).as_rotvec().var(axis=0).mean()))


def test_what_the_image_does_not_show_does_not_drift() -> None:
    film = Film("cylinder", STILL, 30, seed=3)
    tracker = film.tracker()
    answers = [film.show(tracker, i) for i in range(30)]
    T = [e.T_camera_object for e in answers if e.T_camera_object is not None]
    axis = film.obj.symmetry.axis
    assert axis is not None
    spin = se3.inverse(T[3])[:3, :3] @ T[-1][:3, :3]
    across = np.cross(axis, [0.3, -0.5, 0.8])
    across /= np.linalg.norm(across)
    turned = spin @ across
    turned -= (turned @ axis) * axis
    angle = np.arccos(np.clip(turned @ across / np.linalg.norm(turned), -1, 1))
    assert angle < np.radians(2)
    sd = np.sqrt(np.linalg.eigvalsh(answers[-1].covariance[:3, :3]))  # type: ignore[index]
    assert sd[-1] > 3 * sd[0], "and the covariance says that it is not known"


def covered(scene: Scene, shown: np.ndarray) -> np.ndarray:
    """Depth with a board in front of what is marked, shape (H, W)."""
    board = scene.depth.copy()
    v, u = np.nonzero(shown)
    front = scene.images.depth[scene.images.depth > 0].min() - 0.05
    board[max(v.min() - 15, 0) : v.max() + 15, max(u.min() - 15, 0) : u.max() + 15] = front
    return board


def test_a_hidden_object_is_not_invented_and_found_at_once(moving: Film) -> None:
    tracker = moving.tracker()
    for i in range(5):
        assert moving.show(tracker, i).found
    for i in range(5, 10):
        e = moving.show(tracker, i, covered(moving.scenes[i], moving.scenes[i].label > 0))
        assert not e.found
        assert e.reason
        assert e.T_camera_object is None
        assert e.covariance is None
        assert tracker.lost
    answers = [moving.show(tracker, i) for i in (10, 11)]
    assert answers[-1].found
    assert moving.error(answers[-1], 11) < 0.003


def test_an_object_is_followed_while_the_hand_is_hidden(moving: Film) -> None:
    tracker = moving.tracker()
    for i in range(5):
        assert moving.show(tracker, i).found
    for i in range(5, 9):
        scene = moving.scenes[i]
        of_hand = (scene.images.segmentation > 0) & (scene.label != OBJECT) & (scene.depth > 0)
        front = scene.images.depth[scene.images.depth > 0].min() - 0.05
        e = moving.show(tracker, i, np.where(of_hand, front, scene.depth).astype(np.float32))
        assert e.found, e.reason
        assert moving.error(e, i) < 0.004


def test_an_object_taken_away_is_missed_within_three_images(moving: Film) -> None:
    tracker = moving.tracker()
    for i in range(5):
        assert moving.show(tracker, i).found
    fooled = 0
    for i in range(5, 9):
        scene = moving.scenes[i]
        e = moving.show(tracker, i, without_the_object(scene))
        fooled += e.found and e.confidence >= 0.5
    assert fooled <= 3
    assert not e.found


def test_an_object_that_jumps_is_found_again(moving: Film) -> None:
    tracker = moving.tracker()
    for i in range(5):
        assert moving.show(tracker, i).found
    scene = moving.scenes[5]
    T_hand_object = se3.inverse(scene.T_camera_hand) @ scene.T_camera_object
    T_hand_object[:3, :3] = T_hand_object[:3, :3] @ se3.exp_so3(np.array([0.0, 1.2, 0.9]))
    T_hand_object[:3, 3] += [0.0, 0.02, 0.01]
    jumped = Grasp(T_hand_object, moving.hand.joint_vector(scene.joint_positions))
    rng = np.random.default_rng(0)
    around = moving.makes.surroundings(scene.T_camera_hand, rng)
    there = moving.makes.render_in(around, jumped, scene.T_camera_hand)
    right = []
    for i in range(5, 10):
        noisy = with_errors(there, PROTOCOL, rng, scene.T_camera_hand_given)
        e = tracker.update(noisy.depth, CAMERA, scene.T_camera_hand_given)
        T = e.T_camera_object
        close = T is not None and adi(moving.tree, T, there.T_camera_object) < 0.005
        right.append(close)
        assert close or not e.found or e.confidence < 0.5 or i < 8, "an undetected loss"
    assert right[-1]


def without_the_object(scene: Scene) -> np.ndarray:
    """Depth (H, W) without readings of the object."""
    return np.where(scene.images.object_depth == scene.images.depth, 0, scene.depth)


@pytest.mark.parametrize("moves", [False, True])
def test_a_place_is_taken_when_two_searches_agree_on_it(
    moving: Film, followed: list[PoseEstimate], monkeypatch: pytest.MonkeyPatch, moves: bool
) -> None:
    """However sure they are; one that sees the object here and there is not believed."""
    tracker = moving.tracker()
    for i in range(5):
        assert moving.show(tracker, i).found
    image = 5
    searched: list[int] = []
    found: list[bool] = []

    def answer(*_: object) -> PoseEstimate:
        searched.append(image)
        scene, e = moving.scenes[image], followed[image]
        away = se3.inverse(scene.T_camera_hand) @ scene.T_camera_object
        away[:3, 3] += [0.0, 0.03, 0.02 * (image % 2) if moves else 0.0]
        assert e.T_camera_hand is not None
        return replace(e, T_camera_object=e.T_camera_hand @ away, confidence=0.99)

    monkeypatch.setattr(tracker.estimator, "estimate", answer)
    monkeypatch.setattr("inhand.tracking.tracker.stands_beside_the_hand", lambda *_: True)
    for image in range(5, 10):
        e = moving.show(tracker, image, without_the_object(moving.scenes[image]))
        if image in searched:
            found.append(e.found)
    assert len(found) > 1
    assert not found[0]
    assert any(found) is not moves


def test_a_first_answer_that_is_not_sure_needs_a_second(
    moving: Film, followed: list[PoseEstimate], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until then it is what the estimator says, with less confidence."""
    tracker = moving.tracker()
    searches = [replace(e, confidence=c) for e, c in zip(followed, (0.2, 0.7, 0.7), strict=False)]
    monkeypatch.setattr(tracker.estimator, "estimate", lambda *_: searches.pop(0))
    for i, sure in enumerate((0.2, 0.7)):
        e = moving.show(tracker, i)
        np.testing.assert_array_equal(e.T_camera_object, followed[i].T_camera_object)
        assert e.confidence == pytest.approx(0.5 * sure)
        assert e.covariance is not None
        assert tracker.lost
    assert moving.show(tracker, 2).confidence == 0.7
    assert not tracker.lost


def test_others_are_searched_for_while_the_pose_is_unsure(
    still: Film, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = still.tracker(TrackerConfig(rivals=RivalConfig(every=1)))
    answer = still.tracker().estimator.estimate(
        still.scenes[0].depth, CAMERA, still.scenes[0].T_camera_hand_given
    )
    T = answer.T_camera_object
    assert T is not None
    shifted = T @ se3.exp(np.array([0.0, 0.0, 0.0, 0.006, 0.0, 0.0]))
    alike = tuple(Candidate(pose, {"score": 1.5}) for pose in (T, shifted))
    with monkeypatch.context() as patch:
        doubtful = replace(answer, candidates=alike, confidence=0.97)
        patch.setattr(tracker.estimator, "estimate", lambda *_: doubtful)
        first, lost = still.show(tracker, 0), tracker.lost
        assert lost, "a sure answer with a rival as good needs a second"
        assert first.confidence == pytest.approx(0.5 * 0.97)
        still.show(tracker, 1)
    assert not tracker.lost
    answers = [still.show(tracker, i) for i in range(2, 12)]
    assert all(still.error(e, i) < 0.003 for i, e in enumerate(answers, start=2))
    looked = ["rivals" in e.timings for e in answers]
    assert looked[0]
    assert not looked[-1], "the images have told them apart"


def test_an_object_that_comes_to_light_is_searched_for_rivals_once(still: Film) -> None:
    """It is taken where it is expected, by what little shows at first: that may be wrong."""
    tracker = still.tracker()
    for i in range(4):
        assert "rivals" not in still.show(tracker, i).timings
    scene = still.scenes[4]
    assert not still.show(tracker, 4, covered(scene, scene.label > 0)).found
    answers = [still.show(tracker, i) for i in range(5, 12)]
    assert all("wrist" not in answers[i].timings for i in (0, 1)), "it was found without a search"
    assert ["rivals" in e.timings for e in answers] == [False, False, True] + [False] * 4
    assert all(still.error(e, i) < 0.003 for i, e in enumerate(answers, start=5))


def test_a_hidden_finger_stays_where_it_was(moving: Film) -> None:
    tracker = moving.tracker()
    for i in range(5):
        before = moving.show(tracker, i)
    hand, finger = moving.hand, moving.hand.fingers[0]
    names = [hand.joint_names[j] for j in finger.joints]
    links = [1 + link for link in finger.links]
    for i in range(5, 9):
        scene = moving.scenes[i]
        # The finger gives no readings, as little as what is around it.
        of_finger = np.isin(scene.images.segmentation, links)
        after = moving.show(tracker, i, np.where(of_finger, 0, scene.depth).astype(np.float32))
    for name in names:
        assert abs(after.joint_positions[name] - before.joint_positions[name]) < np.radians(10)


def test_senseless_images_are_no_errors(moving: Film) -> None:
    tracker, rng = moving.tracker(), np.random.default_rng(0)
    assert moving.show(tracker, 0).found
    size = (CAMERA.height, CAMERA.width)
    senseless = [
        np.zeros(size, np.float32),
        np.full(size, np.inf, np.float32),
        np.full(size, 0.45, np.float32),
        rng.uniform(0.3, 0.6, size).astype(np.float32),
        np.where(rng.random(size) < 0.9, np.nan, 0.5).astype(np.float32),
    ]
    for i, depth in enumerate(senseless, start=1):
        e = moving.show(tracker, i, depth)
        assert not e.found
        assert e.reason
        assert e.confidence == 0
    behind = np.diag([1.0, 1, 1, 1])
    behind[2, 3] = -1.0
    assert not tracker.update(moving.scenes[6].depth, CAMERA, behind).found
    answers = [moving.show(tracker, i) for i in (7, 8, 9)]
    assert answers[-1].found
    assert moving.error(answers[-1], 9) < 0.005


def test_time_must_rise(moving: Film) -> None:
    tracker = moving.tracker()
    moving.show(tracker, 3)
    with pytest.raises(InputError, match="rise"):
        moving.show(tracker, 3)
    with pytest.raises(InputError, match="time"):
        tracker.update(
            moving.scenes[4].depth, CAMERA, moving.scenes[4].T_camera_hand_given, time=np.nan
        )
    tracker.reset()
    moving.show(tracker, 0)


def test_bad_input_is_refused_and_forgotten(moving: Film, followed: list[PoseEstimate]) -> None:
    tracker = moving.tracker()
    moving.show(tracker, 0)
    with pytest.raises(InputError, match="depth"):
        tracker.update(np.zeros((3, 3), np.float32), CAMERA, np.eye(4), time=0.01)
    with pytest.raises(InputError, match="T_camera_hand"):
        tracker.update(moving.scenes[1].depth, CAMERA, np.eye(3), time=0.02)
    e = moving.show(tracker, 1)
    np.testing.assert_array_equal(e.T_camera_object, followed[1].T_camera_object)


def test_the_configuration_must_be_the_trackers(moving: Film) -> None:
    with pytest.raises(InputError, match="TrackerConfig"):
        PoseTracker(moving.hand, moving.obj, TrackerConfig().estimator)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="rate"):
        TrackerConfig(rate=-1.0)

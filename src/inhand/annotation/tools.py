"""What works on images of one object in the hand: the estimator, the snapper and a renderer."""

from dataclasses import dataclass, replace
from functools import cached_property, partial

from inhand.annotation.images import RawImage
from inhand.annotation.session import Array, Label
from inhand.annotation.snap import Snapper
from inhand.config import EstimatorConfig
from inhand.errors import NoAnswer
from inhand.estimator import PoseEstimator
from inhand.evaluation.metrics import PoseError
from inhand.evaluation.symmetric_poses import nearest_symmetric
from inhand.geometry.se3 import transform
from inhand.hand import Hand
from inhand.object_model import ObjectModel
from inhand.overlay import ModelRenderer


@dataclass(frozen=True, eq=False)
class Proposals:
    """The estimator's answer to an image."""

    image: str
    """Name of the image."""
    labels: tuple[Label, ...]
    """Labels, best first; of poses that a symmetry makes alike there is one."""
    confidence: float
    """Probability that the first one is right."""


@dataclass(frozen=True, eq=False)
class Tools:
    """What works on images of one object in the hand."""

    hand: Hand
    obj: ObjectModel
    config: EstimatorConfig
    device: str

    @cached_property
    def estimator(self) -> PoseEstimator:
        """Proposes poses."""
        return PoseEstimator(self.hand, self.obj, self.config, self.device)

    @cached_property
    def snapper(self) -> Snapper:
        """Refines poses."""
        return Snapper(self.estimator.hand, self.estimator.object, self.config)

    @cached_property
    def renderer(self) -> ModelRenderer:
        """Draws hand and object."""
        return ModelRenderer(self.hand, self.obj, self.device)

    def difference(self, one: Label, other: Label) -> PoseError:
        """How far the objects of two labels are apart, up to the object's symmetries."""
        metric = self.snapper.metric
        return metric.pose_error(one.T_camera_object, other.T_camera_object)

    def centred(self, T_camera_object: Array) -> Array:
        """An object pose, (4, 4), with its origin at the object's centre: what it is turned about.

        A mesh may lie far from its origin.
        """
        T = T_camera_object.copy()
        T[:3, 3] = transform(T_camera_object, self.obj.centre[None])[0]
        return T

    def from_centred(self, T: Array) -> Array:
        """The object's pose, (4, 4), whose `centred` is this."""
        T_camera_object = T.copy()
        T_camera_object[:3, 3] -= T[:3, :3] @ self.obj.centre
        return T_camera_object

    def propose(self, image: str, raw: RawImage, label: Label) -> Proposals:
        """The estimator's answer to an image.

        Args:
            image: name of the image.
            raw: the image.
            label: its label, whose wrist pose the estimator is given.

        Raises:
            NoAnswer: it has none.
        """
        estimate = self.estimator.estimate(raw.depth, raw.camera, label.T_camera_hand)
        if not estimate.found or estimate.T_camera_hand is None:
            raise NoAnswer(estimate.reason)
        joints = {name: estimate.joint_positions[name] for name in self.hand.joint_names}
        hand = replace(label, T_camera_hand=estimate.T_camera_hand, joint_positions=joints)
        nearest = partial(nearest_symmetric, self.snapper.obj.model.symmetry)
        labels = tuple(
            replace(hand, T_camera_object=nearest(label.T_camera_object, c.T_camera_object))
            for c in estimate.candidates
        )
        return Proposals(image, labels, estimate.confidence)

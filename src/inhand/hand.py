"""The hand: links with their surfaces and distance fields, fingers, and forward kinematics."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from inhand.cache import Arrays, cached, put_together, taken_apart
from inhand.checks import number_array
from inhand.errors import InputError
from inhand.geometry import mesh as meshes
from inhand.geometry.distance_field import DistanceField, build_distance_field
from inhand.geometry.mesh import TriangleMesh
from inhand.geometry.sampling import SurfaceSamples, sample_surface
from inhand.geometry.se3 import Array
from inhand.kinematics import KinematicArrays, build_chain, independent_joints
from inhand.reach import reach_sphere
from inhand.urdf import PackagePaths, Robot, Shape, UrdfLink, read_urdf

SAMPLE_SPACING = 0.004
"""Distance between neighbouring surface samples [m] aimed at."""
SAMPLE_COUNTS = (100, 600)
"""Fewest and most surface samples of a link."""
VOXELS_ALONG_LINK = 80
"""A link's diameter in voxels of its distance field, as long as they are not below the next."""
SMALLEST_VOXEL = 0.001
"""Smallest voxel of a distance field [m]."""
FIELD_MARGIN = 0.025
"""How far a distance field reaches beyond its link [m]."""
LINK_DIAMETERS = (0.005, 1.0)
"""The largest link of a hand is expected to be in this range [m]; otherwise its unit is wrong."""
MIMIC_TOLERANCE = 1e-3
"""How far a given mimic joint may be from where its rule puts it [rad, m]."""


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid part of the hand that can be seen."""

    name: str
    """Name of the URDF link."""
    mesh: TriangleMesh
    """All its visual shapes in the link's frame [m]; collision shapes if it has no visual."""
    surface: SurfaceSamples
    """Outward surface samples in the link's frame, 100 to 600 by area."""
    distance_field: DistanceField
    """Signed distance to the link in the link's frame."""


@dataclass(frozen=True)
class Finger:
    """The movable links that one joint on the palm carries.

    Branches that follow the same independent joint through mimic joints are one finger.
    """

    name: str
    """Name of the first link that moves."""
    links: tuple[int, ...]
    """Indices into `Hand.links`, from the palm outward."""
    joints: tuple[int, ...]
    """Indices into `Hand.joint_names`, from the palm outward."""


@dataclass(frozen=True, eq=False)
class Hand:
    """A robot hand; its frame is the root link of the URDF."""

    name: str
    """Name of the robot in the URDF."""
    links: tuple[Link, ...] = field(repr=False)
    """The links with shapes, in the order of the URDF."""
    palm_links: tuple[int, ...]
    """Indices of the links that are rigid with the root link."""
    fingers: tuple[Finger, ...]
    """Found from the kinematic tree; chains without a visible link are none."""
    joint_names: tuple[str, ...]
    """The n independent movable joints, from the palm outward, finger by finger."""
    lower: Array
    """Lower limits [rad, m for prismatic joints], shape (n,); -pi for continuous joints."""
    upper: Array
    """Upper limits [rad, m for prismatic joints], shape (n,); pi for continuous joints."""
    all_joint_names: tuple[str, ...]
    """All movable joints, mimic joints included, in the order of `chain`."""
    chain: KinematicArrays = field(repr=False)
    """The kinematics of `links` as arrays."""
    reach: tuple[Array, float]
    """Centre (3,) and radius [m] of a sphere, hand frame, that holds the hand in every
    configuration within the joint limits."""
    _frame_names: tuple[str, ...] = field(repr=False)
    _frames: KinematicArrays = field(repr=False)

    @classmethod
    def from_urdf(cls, path: str | Path, package_paths: PackagePaths | None = None) -> "Hand":
        """Build the hand that a URDF describes; cached on disk by content.

        Args:
            path: the URDF file. Its root link should be the palm.
            package_paths: folders of the ROS packages in `package://` mesh addresses, by package
                name. Packages that are not given are looked for in the folders above the URDF.

        Raises:
            InputError: the file is missing or no URDF, or describes no hand: see `read_urdf`; a
                mesh cannot be read; no movable link has a shape.
        """
        robot = read_urdf(path, package_paths)
        chain = build_chain(robot, [link.name for link in robot.links if link.shapes])
        if (chain.link_joint < 0).all():
            raise InputError(
                f"{path}: none of the links that its joints move has a <visual> or <collision> "
                "shape, so its configuration cannot be seen"
            )
        links = _build_links(robot)
        if max(link.mesh.diameter for link in links) < LINK_DIAMETERS[0]:
            raise InputError(
                f"{path}: all links are less than {LINK_DIAMETERS[0]} m across; are its meshes in "
                "metres already? Then remove their scale"
            )
        centres, radii = zip(*(link.mesh.bounding_sphere for link in links), strict=True)
        joints = {joint.name: joint for joint in robot.joints}
        names = independent_joints(robot)
        lower = np.array([joints[name].lower for name in names])
        upper = np.array([joints[name].upper for name in names])
        frame_names = tuple(link.name for link in robot.links)
        return cls(
            name=robot.name,
            links=links,
            palm_links=tuple(int(i) for i in np.flatnonzero(chain.link_joint < 0)),
            fingers=_find_fingers(chain, robot),
            joint_names=names,
            lower=lower,
            upper=upper,
            all_joint_names=tuple(joint.name for joint in robot.joints if joint.movable),
            chain=chain,
            reach=reach_sphere(chain, np.stack(centres), np.array(radii), lower, upper),
            _frame_names=frame_names,
            _frames=build_chain(robot, frame_names),
        )

    @property
    def rest(self) -> Array:
        """The joint vector nearest to zero within the limits [rad, m], shape (n,)."""
        return np.asarray(np.clip(0.0, self.lower, self.upper))

    def forward_kinematics(self, q: ArrayLike) -> Array:
        """Poses T_hand_link of `links`, shape (L, 4, 4) or (b, L, 4, 4).

        Args:
            q: positions of the independent joints [rad, m], shape (n,) or (b, n).

        Raises:
            InputError: `q` has another shape or holds something else than finite numbers.
        """
        return self.chain.link_poses(self._check_q(q, dimensions=(1, 2)))

    def link_poses(self, joint_positions: Mapping[str, float]) -> dict[str, Array]:
        """T_hand_link, (4, 4), of every link of the URDF, with or without shapes.

        Args:
            joint_positions: as for `joint_vector`.
        """
        poses = self._frames.link_poses(self.joint_vector(joint_positions))
        return dict(zip(self._frame_names, poses, strict=True))

    def joint_dict(self, q: ArrayLike) -> dict[str, float]:
        """Positions [rad, m] of all movable joints, mimic joints included, from q, shape (n,).

        Raises:
            InputError: `q` has another shape or holds something else than finite numbers.
        """
        positions = self.chain.joint_positions(self._check_q(q, dimensions=(1,)))
        return dict(zip(self.all_joint_names, positions.tolist(), strict=True))

    def joint_vector(self, joint_positions: Mapping[str, float]) -> Array:
        """The vector q, shape (n,), from positions [rad, m] by joint name.

        Args:
            joint_positions: every independent joint. Mimic joints may be given as well where they
                agree with the joint they follow.

        Raises:
            InputError: unknown or missing joints, numbers that are not finite, or a mimic joint
                that is not where the joint it follows puts it.
        """
        unknown = [name for name in joint_positions if name not in self.all_joint_names]
        missing = [name for name in self.joint_names if name not in joint_positions]
        if unknown or missing:
            problem = "unknown" if unknown else "missing"
            raise InputError(
                f"{problem} joint {', '.join(unknown or missing)}; the joints of {self.name}: "
                f"{', '.join(self.joint_names)}"
            )
        given = dict(zip(joint_positions, _finite(list(joint_positions.values())), strict=True))
        q = np.array([given[name] for name in self.joint_names])
        for name, position in self.joint_dict(q).items():
            if abs(given.get(name, position) - position) > MIMIC_TOLERANCE:
                raise InputError(
                    f"joint {name} is given as {given[name]:.4f}, but as a mimic joint it is at "
                    f"{position:.4f}; leave mimic joints out"
                )
        return q

    def _check_q(self, q: ArrayLike, dimensions: tuple[int, ...]) -> Array:
        positions = _finite(q)
        if positions.ndim not in dimensions or positions.shape[-1] != len(self.joint_names):
            raise InputError(
                f"q must have {len(self.joint_names)} joint positions, got shape "
                f"{positions.shape}; the joints of {self.name}: {', '.join(self.joint_names)}"
            )
        return positions


def _finite(positions: ArrayLike) -> Array:
    array = number_array(positions, "joint positions", "numbers").astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError("joint positions hold NaN or infinite numbers")
    return array


def _find_fingers(chain: KinematicArrays, robot: Robot) -> tuple[Finger, ...]:
    """Group the movable joints by the joint on the palm that carries them, and these groups by
    the independent joints they share."""
    together = chain.source[:, None] == chain.source
    carried = np.flatnonzero(chain.parent >= 0)
    together[carried, chain.parent[carried]] = True
    count, group = connected_components(together, directed=False)
    first_links = [joint.child for joint in robot.joints if joint.movable]
    fingers = []
    for number in range(count):
        joints = np.flatnonzero(group == number)
        links = np.flatnonzero(np.isin(chain.link_joint, joints))
        links = links[np.argsort(chain.link_joint[links], kind="stable")]
        if len(links):
            name, sources = first_links[joints[0]], np.unique(chain.source[joints])
            fingers.append(Finger(name, tuple(links.tolist()), tuple(sources.tolist())))
    return tuple(fingers)


# Geometry of the links


def _build_links(robot: Robot) -> tuple[Link, ...]:
    """The links with shapes; links of equal content share one geometry."""
    built: dict[str, Link] = {}
    links = []
    for link in robot.links:
        if not link.shapes:
            continue
        try:
            key = _content_key(link.shapes)
            if key not in built:
                built[key] = _build_link(link, key)
        except (InputError, OSError) as error:
            raise InputError(f'link "{link.name}": {error}') from error
        links.append(replace(built[key], name=link.name))
    return tuple(links)


def _content_key(shapes: Sequence[Shape]) -> str:
    """SHA-256 of everything a link's geometry is made from, in hex."""
    digest = hashlib.sha256()
    for shape in shapes:
        placed = shape.T_link_shape + 0.0  # no negative zeros
        digest.update(f"{shape.kind} {shape.size} {shape.scale} {placed.tolist()}".encode())
        if shape.mesh_path is not None:
            digest.update(shape.mesh_path.suffix.lower().encode())
            digest.update(hashlib.sha256(shape.mesh_path.read_bytes()).digest())
    return digest.hexdigest()


def _build_link(link: UrdfLink, key: str) -> Link:
    settings = (SAMPLE_SPACING, *SAMPLE_COUNTS, VOXELS_ALONG_LINK, SMALLEST_VOXEL, FIELD_MARGIN)
    arrays = cached(["hand link", key, *settings], lambda: _build_geometry(link.shapes))
    return Link(
        link.name,
        put_together(TriangleMesh, "mesh", arrays),
        put_together(SurfaceSamples, "surface", arrays),
        put_together(DistanceField, "field", arrays),
    )


def _build_geometry(shapes: Sequence[Shape]) -> Arrays:
    mesh = meshes.concatenate(
        [meshes.transformed(_shape_mesh(shape), shape.T_link_shape) for shape in shapes]
    )
    if mesh.diameter > LINK_DIAMETERS[1]:
        raise InputError(
            f"it is {mesh.diameter:.4g} m across; is its mesh in millimetres? Then give it "
            'scale="0.001 0.001 0.001" in the URDF'
        )
    count = int(np.clip(mesh.face_areas.sum() / SAMPLE_SPACING**2, *SAMPLE_COUNTS))
    surface = sample_surface(mesh, count, seed=0)
    voxel = max(SMALLEST_VOXEL, mesh.diameter / VOXELS_ALONG_LINK)
    distances = build_distance_field(mesh, voxel, FIELD_MARGIN)
    return taken_apart(mesh=mesh, surface=surface, field=distances)


def _shape_mesh(shape: Shape) -> TriangleMesh:
    if shape.mesh_path is not None:
        return meshes.load_mesh(shape.mesh_path, shape.scale)
    if shape.kind == "box":
        return meshes.box(shape.size)
    if shape.kind == "cylinder":
        return meshes.cylinder(*shape.size)
    return meshes.sphere(*shape.size)

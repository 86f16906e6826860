"""Reading a URDF: its links' shapes and its kinematic tree, checked, with mesh files found.

Nothing is loaded here but XML: the meshes themselves are read when their link is built.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from inhand.checks import file_path
from inhand.errors import InputError
from inhand.geometry.se3 import Array, exp_so3

MOVABLE_KINDS = ("revolute", "continuous", "prismatic")
SHAPE_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
UNREADABLE_XML = (ElementTree.ParseError, LookupError, ValueError)  # also unknown encodings

PackagePaths = Mapping[str, str | Path]
FindMesh = Callable[[str, str], Path]
"""From the address in the URDF and what it belongs to, to the file."""


@dataclass(frozen=True)
class Shape:
    """One visual or collision shape of a link."""

    kind: str
    """box, cylinder, sphere or mesh."""
    T_link_shape: Array
    """Pose of the shape in its link's frame, shape (4, 4)."""
    size: tuple[float, ...] = ()
    """Box: extents x, y, z; cylinder: radius, length; sphere: radius [m]; mesh: empty."""
    mesh_path: Path | None = None
    """The mesh file, which exists; None for primitives."""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factors along the mesh file's axes."""


@dataclass(frozen=True)
class UrdfLink:
    """A link and its shapes: all its visuals, or its collision shapes where it has no visual."""

    name: str
    shapes: tuple[Shape, ...]


@dataclass(frozen=True)
class Mimic:
    """Position of a joint as multiplier * position of `joint` + offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A joint between two links."""

    name: str
    kind: str
    """revolute, continuous, prismatic or fixed."""
    parent: str
    """Name of the parent link."""
    child: str
    """Name of the child link."""
    T_parent_child: Array = field(repr=False)
    """Pose of the child link in the parent link at joint position zero, shape (4, 4)."""
    axis: Array = field(repr=False)
    """Unit axis in the child link's frame, shape (3,)."""
    lower: float
    """Lower limit [rad, m for a prismatic joint]; -pi for a continuous joint."""
    upper: float
    """Upper limit [rad, m for a prismatic joint]; pi for a continuous joint."""
    mimic: Mimic | None

    @property
    def movable(self) -> bool:
        """Whether the joint moves, on its own or as a mimic."""
        return self.kind != "fixed"


@dataclass(frozen=True)
class Robot:
    """A kinematic tree."""

    name: str
    root: str
    """Name of the root link."""
    links: tuple[UrdfLink, ...]
    """In the order of the file."""
    joints: tuple[UrdfJoint, ...]
    """Depth first from the root, so a joint stands behind all joints that carry it; branches in
    the order of the file."""


def read_urdf(path: str | Path, package_paths: PackagePaths | None = None) -> Robot:
    """Read the URDF file at `path`.

    Args:
        path: the URDF file.
        package_paths: folders of the ROS packages named in `package://` mesh addresses, by package
            name. Packages that are not given are looked for in the folders above the URDF.

    Raises:
        InputError: the file is missing or not a URDF, a number or name in it is wrong, a mesh
            file is not found, or its joints do not form one tree with a movable joint.
    """
    path = file_path(path, "URDF file")
    robot = _parse_xml(path)
    name = robot.get("name") or path.stem
    find_mesh = partial(_find_mesh, path.resolve().parent, package_paths or {})
    links = tuple(_read_link(element, find_mesh) for element in robot.findall("link"))
    if not links:
        raise InputError(f"{path} has no <link>: it describes no hand")
    _check_unique("link", (link.name for link in links))
    joints = [_read_joint(element) for element in robot.findall("joint")]
    _check_unique("joint", (joint.name for joint in joints))
    root, ordered = _sort_tree([link.name for link in links], joints)
    if not any(joint.movable for joint in joints):
        raise InputError(
            f"{path} has no movable joint: a hand needs at least one joint of type "
            f"{', '.join(MOVABLE_KINDS)}"
        )
    if not any(link.shapes for link in links):
        raise InputError(f"{path}: no link has a <visual> or <collision> shape to look for")
    return Robot(name, root, links, ordered)


def _parse_xml(path: Path) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read the URDF file {path}: {error.strerror}") from error
    except UNREADABLE_XML as error:
        raise InputError(f"{path} is not a URDF: it is not well-formed XML ({error})") from error
    if root.tag != "robot":
        raise InputError(f"{path} is not a URDF: its root element is <{root.tag}>, not <robot>")
    if any("xacro}" in str(element.tag) for element in root.iter()):
        raise InputError(
            f"{path} is a xacro file: expand it first, with `xacro {path.name} > hand.urdf`"
        )
    return root


def _check_unique(kind: str, names: Iterable[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise InputError(f"the URDF has more than one {kind} named {', '.join(twice)}")


# Elements and numbers


def _attribute(element: ElementTree.Element, key: str, where: str) -> str:
    value = element.get(key)
    if value is None:
        raise InputError(f'{where}: <{element.tag}> lacks the attribute "{key}"')
    return value


def _numbers(text: str, count: int, where: str) -> tuple[float, ...]:
    """`count` finite numbers, separated by spaces or commas."""
    try:
        values = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        values = ()
    if len(values) != count:
        raise InputError(f'{where}: expected {count} number(s), got "{text}"')
    if not all(math.isfinite(value) for value in values):
        raise InputError(f'{where}: "{text}" holds NaN or an infinite number')
    return values


def _read_origin(element: ElementTree.Element, where: str) -> Array:
    """The (4, 4) transform of <origin xyz rpy>: rotation about fixed x, then y, then z."""
    T = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        T[:3, 3] = _numbers(origin.get("xyz", "0 0 0"), 3, f"{where}, origin xyz")
        roll_pitch_yaw = _numbers(origin.get("rpy", "0 0 0"), 3, f"{where}, origin rpy")
        about_x, about_y, about_z = exp_so3(np.diag(roll_pitch_yaw))
        T[:3, :3] = about_z @ about_y @ about_x
    return T


# Links


def _read_link(element: ElementTree.Element, find_mesh: FindMesh) -> UrdfLink:
    name = _attribute(element, "name", "the URDF")
    shapes = element.findall("visual") or element.findall("collision")
    return UrdfLink(name, tuple(_read_shape(s, f'link "{name}"', find_mesh) for s in shapes))


def _read_shape(element: ElementTree.Element, where: str, find_mesh: FindMesh) -> Shape:
    T_link_shape = _read_origin(element, where)
    geometry = element.find("geometry")
    shape = None if geometry is None or len(geometry) == 0 else geometry[0]
    if shape is None or shape.tag not in (*SHAPE_SIZES, "mesh"):
        raise InputError(
            f"{where}: <{element.tag}> needs a <geometry> with a box, cylinder, sphere or mesh, "
            f"got {'nothing' if shape is None else f'<{shape.tag}>'}"
        )
    if shape.tag == "mesh":
        mesh_path = find_mesh(_attribute(shape, "filename", where), where)
        return Shape("mesh", T_link_shape, mesh_path=mesh_path, scale=_read_scale(shape, where))
    size: tuple[float, ...] = ()
    for key in SHAPE_SIZES[shape.tag]:
        text = _attribute(shape, key, where)
        size += _numbers(text, 3 if shape.tag == "box" else 1, f"{where}, {shape.tag} {key}")
    if min(size) <= 0:
        raise InputError(f"{where}: the sizes of a {shape.tag} must be positive, got {size}")
    return Shape(shape.tag, T_link_shape, size=size)


def _read_scale(element: ElementTree.Element, where: str) -> tuple[float, float, float]:
    text = element.get("scale", "1 1 1")
    if len(text.split()) == 1:
        text = f"{text} {text} {text}"
    x, y, z = _numbers(text, 3, f"{where}, mesh scale")
    if x * y * z == 0:
        raise InputError(f'{where}: mesh scale "{text}" flattens the mesh; no factor may be zero')
    return x, y, z


def _find_mesh(folder: Path, package_paths: PackagePaths, address: str, where: str) -> Path:
    """The file behind a mesh address in a URDF of this folder."""
    candidates = _mesh_candidates(folder, package_paths, address)
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    tried = ", ".join(dict.fromkeys(map(str, candidates)))
    hint = "mesh paths are relative to the folder of the URDF"
    if address.startswith(("package://", "model://")):
        package = address.split("/")[2]
        hint = f'say where the package is with package_paths={{"{package}": folder}}'
    raise InputError(f"{where}: mesh file {address} not found; tried {tried}; {hint}")


def _mesh_candidates(folder: Path, package_paths: PackagePaths, address: str) -> list[Path]:
    """Where a mesh may lie, for an address that is a path, `file://` or `package://`."""
    scheme, separator, rest = address.partition("://")
    if not separator:
        return [folder / address]
    if scheme == "file":
        return [folder / unquote(rest)]
    if scheme not in ("package", "model"):
        raise InputError(
            f"cannot read mesh address {address}: expected a path, file:// or package://"
        )
    package, _, inside = rest.partition("/")
    if package in package_paths:
        return [Path(package_paths[package]) / inside]
    above = (folder, *folder.parents)
    packages = [f for f in above if package in (f.name, _package_name(f))]
    packages += [f / package for f in above]
    # Copied out of its package, a URDF usually keeps its meshes beside it or one folder up.
    packages += above[:2]
    return [f / inside for f in packages]


def _package_name(folder: Path) -> str | None:
    """The name in the folder's package.xml; without one, a package is named as its folder."""
    try:
        return ElementTree.parse(folder / "package.xml").findtext("name", "").strip()
    except (OSError, *UNREADABLE_XML):
        return None


# Joints


def _read_joint(element: ElementTree.Element) -> UrdfJoint:
    name = _attribute(element, "name", "the URDF")
    where = f'joint "{name}"'
    kind = _attribute(element, "type", where)
    if kind not in (*MOVABLE_KINDS, "fixed"):
        raise InputError(
            f'{where} has the unsupported type "{kind}"; supported: '
            f"{', '.join((*MOVABLE_KINDS, 'fixed'))}. The wrist pose belongs to the input, not to "
            "the URDF: let the file start at the palm, and split other joints into these types"
        )
    parent, child = (
        _attribute(next(element.iterfind(end), ElementTree.Element(end)), "link", where)
        for end in ("parent", "child")
    )
    mimic = _read_mimic(element, where) if kind != "fixed" else None
    lower, upper = _read_limits(element, kind, mimic is not None, where)
    return UrdfJoint(
        name,
        kind,
        parent,
        child,
        T_parent_child=_read_origin(element, where),
        axis=_read_axis(element, kind, where),
        lower=lower,
        upper=upper,
        mimic=mimic,
    )


def _read_axis(element: ElementTree.Element, kind: str, where: str) -> Array:
    axis = element.find("axis")
    if axis is None or kind == "fixed":
        return np.array([1.0, 0.0, 0.0])  # the default of the URDF format
    direction = np.array(_numbers(axis.get("xyz", "1 0 0"), 3, f"{where}, axis xyz"))
    length = np.linalg.norm(direction)
    if length < 1e-6:
        raise InputError(f"{where}: its axis is the zero vector; give a direction")
    return np.asarray(direction / length)


def _read_limits(
    element: ElementTree.Element, kind: str, is_mimic: bool, where: str
) -> tuple[float, float]:
    limit = element.find("limit")
    if kind == "fixed":
        return 0.0, 0.0
    if kind == "continuous":
        return -math.pi, math.pi
    if limit is None:
        if is_mimic:  # it goes where the joint it follows takes it
            return -math.inf, math.inf
        raise InputError(
            f"{where} is {kind} and needs <limit lower upper>; a joint that turns without end "
            'has the type "continuous"'
        )
    (lower,) = _numbers(limit.get("lower", "0"), 1, f"{where}, limit lower")
    (upper,) = _numbers(limit.get("upper", "0"), 1, f"{where}, limit upper")
    if lower > upper:
        raise InputError(f"{where}: its lower limit {lower} is above its upper limit {upper}")
    return lower, upper


def _read_mimic(element: ElementTree.Element, where: str) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    (multiplier,) = _numbers(mimic.get("multiplier", "1"), 1, f"{where}, mimic multiplier")
    (offset,) = _numbers(mimic.get("offset", "0"), 1, f"{where}, mimic offset")
    return Mimic(_attribute(mimic, "joint", where), multiplier, offset)


# The tree


def _sort_tree(link_names: list[str], joints: list[UrdfJoint]) -> tuple[str, tuple[UrdfJoint, ...]]:
    """The root link, and the joints depth first.

    Raises:
        InputError: a joint names an unknown link, or the joints do not form one tree.
    """
    carried_by: dict[str, str] = {}
    children: dict[str, list[UrdfJoint]] = {name: [] for name in link_names}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in children:
                raise InputError(
                    f'joint "{joint.name}" names the link "{link}", which the URDF does not have; '
                    f"its links: {', '.join(link_names)}"
                )
        if joint.child in carried_by:
            raise InputError(
                f'link "{joint.child}" is the child of two joints, "{carried_by[joint.child]}" '
                f'and "{joint.name}": a kinematic loop. Remove one of them; a closed linkage is '
                "written as a tree with mimic joints"
            )
        carried_by[joint.child] = joint.name
        children[joint.parent].append(joint)

    roots = [name for name in link_names if name not in carried_by]
    if len(roots) > 1:
        raise InputError(
            f"the URDF has {len(roots)} root links, expected one: {', '.join(roots)}. Connect "
            "them with fixed joints or remove the unused ones"
        )
    ordered: list[UrdfJoint] = []
    waiting = [joint for root in roots for joint in reversed(children[root])]
    while waiting:
        joint = waiting.pop()
        ordered.append(joint)
        waiting.extend(reversed(children[joint.child]))
    if not roots or len(ordered) < len(joints):
        in_tree = {joint.name for joint in ordered}
        in_loop = [joint.name for joint in joints if joint.name not in in_tree]
        raise InputError(f"the joints {', '.join(in_loop)} form a kinematic loop without a root")
    return roots[0], tuple(ordered)

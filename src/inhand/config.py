"""Every parameter of the estimator, one frozen section a stage.

Each field is documented with its unit and meaning, and the paper's value where it has one.
`EstimatorConfig()` is the default method; `EstimatorConfig.paper()` is the method of Wen et al.
(ICRA 2020) as published.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from inhand.checks import finite_number, whole_number
from inhand.errors import InputError

# Ranges of the fields below. A plain `float` must be positive, a plain `int` at least 1.
NonNegative = Annotated[float, 0.0, math.inf]
Real = Annotated[float, -math.inf, math.inf]
Share = Annotated[float, 0.0, 1.0]
Angle = Annotated[float, 0.0, math.pi]
Seed = Annotated[int, 0]


class Section:
    """A part of the configuration; its fields are checked against their types when it is made.

    Raises:
        InputError: a field is of another kind or out of its range.
    """

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self), include_extras=True).items():
            value = _checked(getattr(self, name), kind, f"{type(self).__name__}.{name}")
            object.__setattr__(self, name, value)

    def _check_order(self, smaller: str, larger: str) -> None:
        low, high = getattr(self, smaller), getattr(self, larger)
        if low >= high:
            raise InputError(
                f"{type(self).__name__}: {smaller} = {low:g} must be below {larger} = {high:g}"
            )


def _checked(value: Any, kind: Any, name: str) -> Any:
    """`value` as a plain value of a field's type."""
    if get_origin(kind) is Literal:
        if not isinstance(value, str) or value not in get_args(kind):
            methods = " or ".join(f'"{method}"' for method in get_args(kind))
            raise InputError(f"{name} must be {methods}, got {value!r:.80}")
        return value
    number, *ends = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if number is int:
        return whole_number(value, name, *ends or [1])
    if number is not float:
        if not isinstance(value, kind):
            raise InputError(f"{name} must be a {kind.__name__}, got {value!r:.80}")
        return value
    checked = finite_number(value, name)
    low, high = ends or (0.0, math.inf)
    if not low <= checked <= high or (not ends and checked == 0):
        expected = f"between {low:g} and {high:g}" if ends else "above 0"
        raise InputError(f"{name} must be {expected}, got {checked:g}")
    return checked


@dataclass(frozen=True)
class ObservationConfig(Section):
    """Region of interest, surface estimates and scene cloud."""

    margin: NonNegative = 0.01
    """Added to the hand's reach and the object's size for the region of interest [m]."""
    point_spacing: float = 0.0025
    """Distance between neighbouring points of the scene cloud P_S [m]."""
    normal_window: float = 0.004
    """Radius of the neighbourhood that a normal is fitted to [m]."""
    normal_gate: float = 1.5
    """A neighbour whose depth differs by more than this times `normal_window` is left out."""
    missing_window: int = 9
    """Radius of the window that tells small holes from areas without any reading [pixel]."""
    noise_spacing: int = 3
    """Distance of the readings that the image's noise is estimated from [pixel]."""
    min_points: int = 50
    """Fewer readings in the region of interest than this: no answer."""


@dataclass(frozen=True)
class WristConfig(Section):
    """Correction of the wrist pose."""

    method: Literal["prior", "icp"] = "prior"
    """`icp`: the paper's; `prior`: held to the given pose where the image says nothing."""
    prior_sd_translation: float = 0.005
    """Standard deviation per axis of the given wrist pose [m]."""
    prior_sd_rotation: float = 0.03
    """Standard deviation per axis of the given wrist pose [rad]."""
    samples: int = 128
    """`prior`: poses tried around the given one."""
    search_sd_translation: float = 0.006
    """Standard deviation per axis of these [m]."""
    search_sd_rotation: float = 0.04
    """Standard deviation per axis of these [rad]."""
    starts: int = 5
    """`prior`: poses that are refined: the given one and the best of those tried."""
    iterations: int = 6
    """Gauss-Newton or ICP iterations."""
    max_distance: float = 0.015
    """Scene points farther from the model than this do not take part [m]."""
    max_normal_angle: Angle = 0.35
    """`icp`: nor do points whose normal differs by more than this from the model's [rad]."""
    last_width: float = 0.005
    """Width of the redescending weight in the last iteration [m]."""
    point_information: float = 2.0e4
    """Information of one surface point [1/m^2], see `HandStateConfig.point_information`."""


@dataclass(frozen=True)
class HandStateConfig(Section):
    """Search and refinement of the finger angles."""

    method: Literal["visibility", "swarm"] = "visibility"
    """`swarm`: the paper's particle swarm on Alg. 1; `visibility`: projective search, then a
    joint Gauss-Newton over wrist and fingers."""
    samples: int = 512
    """Configurations tried per finger, doubled for every second joint of it, at most four times;
    rounded down to a power of two."""
    shortlist: int = 512
    """The best of these that are tried once more beside the other fingers."""
    alternatives: int = 4
    """Distinct configurations per finger that enter the joint refinement."""
    distinct_angle: NonNegative = 0.1
    """Configurations that differ by less than this in every joint are one [rad]."""
    distinct_spacings: NonNegative = 2.0
    """So are those that differ in every joint by less than so many times the spacing of all that
    are tried, which grows with the number of joints."""
    slide_scale: float = 0.05
    """Metres of a prismatic joint that count as one radian in angles and spreads [m/rad]."""
    first_points: int = 24
    """Surface samples of a link while a finger is searched alone."""
    coarse_points: int = 64
    """Surface samples of a link while a finger is searched beside the others, and of the palm."""
    fine_points: int = 200
    """Surface samples of a link around an alternative."""
    early_points: int = 32
    """After so many samples a hopeless configuration is given up."""
    hopeless: Real = -0.5
    """A configuration that scores less is hopeless."""
    coarse_tolerance: float = 0.008
    """Depth agreement during the search [m]."""
    fine_tolerance: float = 0.004
    """Depth agreement when refined configurations are compared [m]."""
    noise_tolerance: NonNegative = 2.0
    """Depth agreement at least, in standard deviations of the image's noise."""
    wrist_slack: NonNegative = 0.003
    """A finger that is searched may lie so far beside where the wrist puts it [m]."""
    violation: NonNegative = 2.0
    """Penalty of a surface point that the camera looked through, in units of one agreeing point."""
    missing: NonNegative = 0.5
    """Penalty of a surface point in the middle of an area without readings."""
    hidden: NonNegative = 0.05
    """Penalty of a surface point behind something else."""
    allowed: int = 256
    """Configurations per finger that are kept for placing a hidden finger against the object."""
    local_samples: int = 32
    """Configurations tried around every alternative before the joint refinement."""
    local_spread: NonNegative = 0.07
    """Standard deviation of these around the alternative [rad]."""
    first_width: float = 0.012
    """Width of the redescending weight in the first iteration of the joint refinement [m]."""
    middle_width: float = 0.006
    """Width of the redescending weight in the last iteration of the starts [m]."""
    last_width: float = 0.004
    """Width of the redescending weight in the last iteration [m]."""
    iterations: int = 3
    """Gauss-Newton iterations of every start."""
    last_iterations: int = 3
    """Gauss-Newton iterations of the best of the starts."""
    start_stride: int = 2
    """Every so-many-th point takes part in the iterations of the starts."""
    point_information: float = 2.0e4
    """Information of one surface point in the refinement [1/m^2]: about 1/(1.5 mm)^2, over the
    number of neighbouring points whose errors go together."""
    joint_damping: float = 4.0
    """Information that holds every joint at its current angle in one iteration [1/rad^2]."""
    certain_support: NonNegative = 0.3
    """A finger link that scores less, per share of it that nothing hides, is not relied on."""
    min_hand_support: Real = -0.05
    """A whole hand that scores less, per share of it that nothing hides, is not in the image."""
    finger_blame: Share = 0.3
    """Share of a finger link's score below zero that counts for the whole hand: the hand may be
    right and the finger elsewhere."""
    missing_blame: Share = 0.5
    """Share of the penalties for missing readings that counts for the whole hand: the sensor may
    have none of what is there."""
    min_seen: float = 0.07
    """Shares that nothing hides count as this at least."""
    render_step: int = 4
    """The palm and the other fingers are rendered at every so-many-th pixel."""
    particles: int = 15
    """Particles of the swarm. Paper: 15."""
    generations: int = 3
    """Generations of the swarm. Paper: 3."""
    swarm_inertia: NonNegative = 0.7
    """Largest weight of a particle's previous velocity."""
    swarm_pull: NonNegative = 1.5
    """Largest weight of the ways to the particle's own best and to the swarm's best position."""
    lcp_distance: float = 0.005
    """Alg. 1: a finger point nearer than this to the scene counts [m]."""
    lcp_normal_angle: Angle = 0.7854
    """Alg. 1: and whose normal differs by less than this [rad]."""
    collision_distance: NonNegative = 0.002
    """Alg. 1: deeper penetration of another finger than this is penalised [m]."""
    collision_penalty: NonNegative = 1.0e4
    """Alg. 1: lambda_c, per metre of penetration and once. Paper: "very large"."""


@dataclass(frozen=True)
class SegmentationConfig(Section):
    """Removal of the hand from the scene cloud."""

    method: Literal["soft", "threshold", "none"] = "soft"
    """`threshold`: the paper's; `soft`: points near the hand keep a weight; `none`: the hand stays,
    for comparison."""
    hand_distance: NonNegative = 0.003
    """Points with a smaller signed distance to the hand are the hand's [m]. Paper: 3 mm."""
    uncertain_weight: Share = 0.1
    """`soft`: weight of a point that only a link without support in the image explains."""
    certain_distance: float = 0.006
    """`soft`: from this distance on a point is certainly not the hand's [m]."""
    max_length: float = 1.15
    """`soft`: a connected surface that is longer, in object diameters, is background."""
    surface_step: float = 0.003
    """`soft`: a surface ends where the next point is farther than this from its tangent plane; so
    near the plane of the next background, a point is background [m]."""
    crease: NonNegative = 0.25
    """`soft`: and where it bends towards the camera by more than this from cell to cell [rad]."""
    dense_below: int = 400
    """`soft`: a segment of fewer points is taken again from a finer scene cloud."""
    dense_points: int = 1200
    """`soft`: which is to have about so many points in it, as far as there are pixels."""
    min_points: int = 20
    """Fewer object points than this: no answer."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_order("hand_distance", "certain_distance")


@dataclass(frozen=True)
class EvidenceConfig(Section):
    """How object poses are scored against the image."""

    hand_step: int = 4
    """The hand is rendered at every so-many-th pixel."""
    violation: NonNegative = 2.0
    """Penalty of a model point that the camera looked through, in units of one that agrees."""
    missing: NonNegative = 1.0
    """Penalty of a model point in the middle of an area without readings."""
    hidden: NonNegative = 0.1
    """Penalty of a model point behind a reading that the hand does not explain."""
    near: float = 0.004
    """A segment point this near to the model's surface is explained [m]."""
    share_weight: NonNegative = 2.0
    """Weight of the explained share of the segment against the visible share of the model."""
    free_penetration: NonNegative = 0.0015
    """Penetration of the hand that model errors explain [m]."""
    penetration_scale: float = 0.008
    """Penetration beyond that costs one agreeing surface per this length [m]."""
    free_gap: NonNegative = 0.005
    """Gap between object and nearest finger that model errors explain [m]."""
    uncertain_gap: NonNegative = 0.040
    """The same while the place of some link is unknown [m]."""
    gap_scale: float = 0.030
    """A gap beyond that costs one agreeing surface per this length [m]."""
    finger_apart: NonNegative = 0.5
    """Penalty when no finger touches the object; a part of it for every finger that does not."""
    free_finger_gap: NonNegative = 0.002
    """A finger this near touches the object [m]."""
    finger_gap_scale: float = 0.020
    """A finger farther away than that by this much does not [m]."""
    max_contact_penalty: NonNegative = 1.0
    """Penalty of penetration or of the gap to the nearest finger at most."""


@dataclass(frozen=True)
class HypothesesConfig(Section):
    """Generation of object poses."""

    method: Literal["pairs", "congruent_sets"] = "pairs"
    """`congruent_sets`: the paper's Alg. 2 and Super4PCS extraction; `pairs`: oriented pairs."""
    pairs: int = 800
    """`pairs`: scene pairs sampled."""
    matches: int = 16
    """`pairs`: model pairs drawn for each."""
    partner_tries: int = 4
    """`pairs`: second points tried for each first one."""
    min_width: NonNegative = 0.2
    """`pairs`: shortest wanted pair, in object diameters."""
    max_width: float = 0.9
    """`pairs`: longest wanted pair, in object diameters."""
    tolerance: float = 0.006
    """`pairs`: depth agreement of a model point with its pixel [m]."""
    model_points: int = 24
    """`pairs`: model points in the first scoring."""
    contact_points: int = 8
    """`pairs`: model points held against the hand in it."""
    segment_points: int = 24
    """`pairs`: segment points in it."""
    keep: int = 500
    """`pairs`: poses passed on at most, the best by this scoring."""
    heuristic_decay: float = 300.0
    """lambda of pi(p) ~ 1 - exp(-lambda SDF) [1/m]."""
    heuristic: bool = True
    """`congruent_sets`: sample points by pi(p); if not, all alike, for comparison."""
    ppf_constraint: bool = True
    """`congruent_sets`: bases and their congruent sets must agree in their point pair features; if
    not, in lengths and the angle between the pairs alone, for comparison."""
    sampling_discount: Share = 0.5
    """gamma: factor on a point's probability each time it is sampled. Paper: 0.5."""
    bases: int = 100
    """Number of 4-point bases sampled."""
    max_tries: int = 100
    """max_iter of Alg. 2."""
    coplanarity: float = 0.003
    """Distance of the fourth point to the plane of the other three at most [m]."""
    min_angle: Angle = 0.5236
    """delta of Alg. 2: smallest angle between b1b2 and b1b3 [rad]."""
    congruence: float = 0.004
    """Tolerance of pair lengths and intermediate points in the congruent-set extraction [m]."""
    congruence_angle: Angle = 0.35
    """Tolerance of the angles in the congruent-set extraction [rad]."""
    max_pairs_per_base: int = 500
    """Model pairs like one of a base's two pairs that are tried at most."""
    max_sets_per_base: int = 300
    """Congruent sets aligned per base at most."""
    lcp_distance: float = 0.003
    """LCP: a segment point nearer than this to the model counts [m]."""
    lcp_normal_angle: Angle = 0.5236
    """LCP: and whose normal differs by less than this [rad]."""
    lcp_points: int = 300
    """LCP: segment points used at most."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_order("min_width", "max_width")


@dataclass(frozen=True)
class ClusteringConfig(Section):
    """Reduction of the hypotheses to distinct poses."""

    method: Literal["distinct", "se3"] = "distinct"
    """`se3`: the paper's, Euclidean then geodesic; `distinct`: greedy by score."""
    tolerance: float = 0.006
    """`distinct`: depth agreement of a model point with its pixel [m]."""
    model_points: int = 100
    """`distinct`: model points in that scoring."""
    contact_points: int = 16
    """`distinct`: model points held against the hand."""
    segment_points: int = 100
    """`distinct`: segment points in that scoring."""
    surface_distance: float = 0.002
    """`distinct`: poses whose surfaces are farther apart on average are distinct [m]."""
    distance: float = 0.005
    """Poses farther apart than this are distinct [m]."""
    angle: Angle = 0.2618
    """Poses whose rotations differ by more than this are distinct [rad]."""
    keep: int = 100
    """Clusters passed on at most."""


@dataclass(frozen=True)
class RefinementConfig(Section):
    """Refinement of every pose that is left."""

    method: Literal["field", "icp"] = "field"
    """`icp`: the paper's point-to-plane ICP; `field`: Gauss-Newton on the distance field."""
    iterations: int = 8
    """Iterations; `field`: of the poses that are kept."""
    segment_points: int = 300
    """`field`: segment points used in the scoring before these."""
    model_points: int = 800
    """`field`: model points used in it and, with as many segment points, in these."""
    rough_iterations: int = 4
    """`field`: iterations of all poses before."""
    rough_points: int = 100
    """`field`: segment points, and model points, used in those."""
    tolerance: float = 0.005
    """`field`: depth agreement of a model point with its pixel in the scoring between them [m]."""
    contact_points: int = 24
    """`field`: model points held against the hand in it."""
    surface_distance: float = 0.001
    """`field`: poses whose surfaces are nearer on average are one by then [m]."""
    image_weight: NonNegative = 0.3
    """`field`: weight of a visible model point against a segment point."""
    first_width: float = 0.010
    """`field`: width of the redescending weight in the first iteration [m]."""
    middle_width: float = 0.007
    """`field`: and between rough and last iterations [m]."""
    last_width: float = 0.004
    """`field`: and in the last [m]."""
    max_distance: float = 0.010
    """Correspondences farther than this are ignored [m]."""
    max_normal_angle: Angle = 0.7854
    """`icp`: so are those whose normals differ by more than this [rad]."""
    merge_distance: NonNegative = 0.002
    """Poses nearer than this and `merge_angle` are one afterwards [m]."""
    merge_angle: Angle = 0.0873
    """Poses nearer than this and `merge_distance` are one afterwards [rad]."""
    keep: int = 30
    """Poses kept with the highest score; `field`: that are refined further. Paper: 100."""
    lcp_distance: float = 0.003
    """LCP: a segment point nearer than this to the model counts [m]."""
    lcp_normal_angle: Angle = 0.5236
    """LCP: and whose normal differs by less than this [rad]."""


@dataclass(frozen=True)
class PruningConfig(Section):
    """Rejection of physically impossible poses."""

    method: Literal["none", "physics"] = "none"
    """`physics`: the paper's gates; `none`: left to the likelihood."""
    max_penetration: NonNegative = 0.012
    """Object poses deeper in the hand than this are rejected [m]."""
    max_gap: NonNegative = 0.010
    """Object poses farther from the hand than this do not touch it and are rejected [m]."""


@dataclass(frozen=True)
class PrecisionConfig(Section):
    """How firmly the image holds the answer: how the score drops where it may have slid to."""

    points: int = 300
    """About how many segment points and how many model points the precision is computed from."""
    width: float = 0.004
    """Width of their redescending weight [m]."""
    image_weight: NonNegative = 0.3
    """Weight of a visible model point against a segment point."""
    point_information: float = 2.0e5
    """Information of one segment point [1/m^2]."""
    turn: float = 0.1
    """Sd per axis of what is known without the image [rad] ..."""
    shift: float = 0.005
    """... and [m]."""
    probe: float = 0.006
    """The score is probed where the surface has moved by this [m], root mean square."""
    max_drop: float = 0.6
    """A larger drop of the score at a probe says nothing more."""


@dataclass(frozen=True)
class SelectionConfig(Section):
    """Choice of the answer among the poses that are left."""

    method: Literal["likelihood", "render"] = "likelihood"
    """`render`: the paper's depth discrepancy, then LCP; `likelihood`: one score for all."""
    keep_share: float = 1 / 3
    """Share kept by the rendering discrepancy. Paper: 1/3."""
    max_discrepancy: float = 0.03
    """Depth differences are cut off here [m]."""
    ray_spacing: float = 0.003
    """Distance between neighbouring rays of the rendering at the hand [m]."""
    empty_share: Share = 0.5
    """A pixel without a reading is empty space if this share of its neighbours has none either."""
    lcp_distance: float = 0.003
    """LCP: a segment point nearer than this to the model counts [m]."""
    lcp_normal_angle: Angle = 0.5236
    """LCP: and whose normal differs by less than this [rad]."""
    tolerance: float = 0.003
    """`likelihood`: depth agreement of a model point with its pixel [m]."""
    model_points: int = 800
    """`likelihood`: model points used."""
    contact_points: int = 256
    """`likelihood`: model points held against the hand."""
    segment_points: int = 800
    """`likelihood`: segment points used."""
    near: float = 0.002
    """`likelihood`: a segment point this near to the model's surface is explained [m]; nearer than
    for poses that are not refined yet."""
    grasps: int = 12
    """`likelihood`: poses that hidden fingers are placed against."""
    finger_points: int = 12
    """`likelihood`: surface samples of a finger link that are held against the object for it."""
    placed_finger_points: int = 25
    """`likelihood`: the same against the first pose, to place the finger."""
    finger_visibility: NonNegative = 0.5
    """`likelihood`: weight of a configuration's visibility score in it."""
    finger_elsewhere: NonNegative = 0.2
    """`likelihood`: what must be gained by it for a finger to be reported elsewhere than the image
    does."""
    merge_distance: NonNegative = 0.001
    """Poses whose surfaces are nearer on average are one [m]."""
    rival_distance: float = 0.004
    """A pose whose surface is farther from the first one's on average is a rival [m]."""
    max_lead: float = 0.3
    """A larger lead in score over the best rival says nothing more."""
    max_visible: Real = 0.1
    """A larger score of what the camera sees of the first pose says nothing more."""
    misfit_reach: float = 0.006
    """Segment points this near to the first pose's surface are on it, and should be so exactly:
    how much farther off they are than the hand's tells a wrong pose or model [m]. To compare like
    with like, as large as `SegmentationConfig.certain_distance`, up to which points are the
    hand's."""
    max_readings: float = 200
    """More segment points on the first pose's surface than this say nothing more."""
    confidence_bias: Real = -3.95
    """Log odds that a pose without agreement, lead or drop, seen in one reading, is right. This and
    the six below are a logistic regression over 1,072 frames of three hands and, at 0.25 of the
    weight, 830 with more noise, less depth, wrong intrinsics, wavy surfaces or a model 3 % too
    large; and, at 0.05 of either's weight, 1,754 with the model of another object."""
    confidence_visible: float = 5.7
    """Log odds per unit of the score of what the camera sees."""
    confidence_readings: float = 0.65
    """Log odds per unit of the logarithm of the number of segment points on the surface."""
    confidence_misfit: float = 5500
    """Log odds taken away per metre that the segment is farther off its surface than the hand."""
    confidence_contact: float = 3.25
    """Log odds taken away per unit of the contact penalty."""
    confidence_lead: float = 4.75
    """Log odds per unit of the lead's square root."""
    confidence_drop: float = 4.3
    """Log odds per unit by which the score drops at the probes, on average."""
    precision: PrecisionConfig = field(default_factory=PrecisionConfig)
    """Where these are."""
    candidates: int = 10
    """Ranked alternatives reported."""


@dataclass(frozen=True)
class FirstLookConfig(Section):
    """A quick search for the object, whose answer is taken if it is sure."""

    enough: Share = 0.95
    """An answer of this confidence is taken; 1: there is no first look."""
    pairs: int = 100
    """`HypothesesConfig.pairs` of it."""
    hypotheses: int = 100
    """`HypothesesConfig.keep` of it."""
    clusters: int = 30
    """`ClusteringConfig.keep` of it."""
    refined: int = 12
    """`RefinementConfig.keep` of it."""


@dataclass(frozen=True)
class SecondLookConfig(Section):
    """Looking for fingers that were missed: in what was taken for the object, when the answer is
    unsure, and in what the answer leaves over."""

    below: Share = 0.6
    """An answer of a smaller confidence is looked at again; 0: none is."""
    samples: int = 128
    """Configurations of a finger that are tried, doubled and rounded as in `HandStateConfig`."""
    points: int = 200
    """About so many segment points are held against them."""
    doubt_below: Share = 0.95
    """An answer of a smaller confidence is doubted if a finger without support could explain most
    of the segment, and is looked for again if fingers explain what it leaves; 0: none is."""
    undoubted: Share = 0.6
    """A finger that could explain no more of it than this does not speak against the answer."""
    doubt: NonNegative = 16.5
    """Log odds taken from the confidence per unit of the share beyond that."""
    near: float = 0.006
    """A segment point this near to a finger's surface starts to be explained by it [m]. What is
    farther off the object and all links is left over."""
    promising: Share = 0.15
    """A finger that explains less of the segment, wherever it is, is not refined."""
    explained: Share = 0.3
    """A finger that explains less of the segment afterwards is no answer."""
    link_explained: Share = 0.1
    """A link that explains more of the segment is relied on."""
    left_explained: Share = 0.5
    """A finger without support goes where it explains such a share of the segment's points that
    object and hand leave; 1: none does."""
    least_left: float = 20.0
    """It explains so many of them at least, however closely they are spaced."""
    iterations: int = 10
    """Gauss-Newton iterations of a hand."""


@dataclass(frozen=True)
class EstimatorConfig(Section):
    """All parameters of `PoseEstimator`."""

    seed: Seed = 0
    """Seed of everything random: the same seed gives the same answer, bit for bit."""
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    wrist: WristConfig = field(default_factory=WristConfig)
    hand_state: HandStateConfig = field(default_factory=HandStateConfig)
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)
    evidence: EvidenceConfig = field(default_factory=EvidenceConfig)
    hypotheses: HypothesesConfig = field(default_factory=HypothesesConfig)
    clustering: ClusteringConfig = field(default_factory=ClusteringConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    pruning: PruningConfig = field(default_factory=PruningConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    first_look: FirstLookConfig = field(default_factory=FirstLookConfig)
    second_look: SecondLookConfig = field(default_factory=SecondLookConfig)

    @cached_property
    def quick(self) -> "EstimatorConfig":
        """The parameters of the first look."""
        look = self.first_look
        return replace(
            self,
            hypotheses=replace(self.hypotheses, pairs=look.pairs, keep=look.hypotheses),
            clustering=replace(self.clustering, keep=look.clusters),
            refinement=replace(self.refinement, keep=look.refined),
        )

    @classmethod
    def paper(cls, seed: int = 0) -> "EstimatorConfig":
        """The method of the paper, stage by stage."""
        return cls(
            seed=seed,
            wrist=WristConfig(method="icp", iterations=12),
            hand_state=HandStateConfig(method="swarm"),
            segmentation=SegmentationConfig(method="threshold"),
            hypotheses=HypothesesConfig(method="congruent_sets"),
            clustering=ClusteringConfig(method="se3"),
            refinement=RefinementConfig(method="icp", iterations=12, keep=100),
            pruning=PruningConfig(method="physics"),
            selection=SelectionConfig(method="render"),
            first_look=FirstLookConfig(enough=1.0),
            second_look=SecondLookConfig(below=0.0, doubt_below=0.0, left_explained=1.0),
        )

"""Settings of tracking: noise, gates, classes, blending.

Invariants:
- Frozen values in SI units with their ranges; nothing is computed.
"""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from annotated_types import Ge, Gt, Le, Len, Lt

# Wider than any measured value. Narrow enough that a covariance stays positive in 64 bits, whatever
# is set while the filter runs.
Length = Annotated[float, Ge(1e-5), Le(0.05)]
Correction = Annotated[float, Ge(-0.003), Le(0.003)]
Angle = Annotated[float, Ge(1e-5), Le(0.1)]
Turn = Annotated[float, Ge(-0.01), Le(0.01)]
Slope = Annotated[float, Ge(0.0), Le(0.1)]
Walk = Annotated[float, Ge(1e-7), Le(0.01)]
Sigmas = Annotated[float, Ge(1.0), Le(100.0)]
LogOdds = Annotated[float, Ge(0.0), Le(1000.0)]  # an onset bank without hypotheses has -30
Constant = Annotated[float, Ge(0.01), Le(100.0)]
Frequency = Annotated[float, Ge(0.01), Le(50.0)]
Force = Annotated[float, Ge(0.5), Le(10_000.0)]
Stiffness = Annotated[float, Ge(1000.0), Le(1e8)]
TurningStiffness = Annotated[float, Ge(10.0), Le(1e7)]
Lever = Annotated[float, Ge(-10.0), Le(10.0)]


class ClassifierKind(StrEnum):
    """Classifier of the conveyor's motion."""

    RULE = "rule"
    IMM = "imm"
    BANK = "bank"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class DistanceNoise:
    """Noise model of the distance sensor.

    Attributes:
        deviation: one sigma, quantisation included [m].
        delay: from measuring to arrival [s].
        late: what it is later than ``delay``, as assemblies have shown [s].
        scale: way of the object for each metre that it reads, as assemblies have shown: its wheel
            slips, or has another size.
        gate: reject an innovation beyond this many sigma.
    """

    deviation: Length = 0.00038
    delay: Annotated[float, Ge(0.0), Le(0.1)] = 0.001
    late: Annotated[float, Ge(-0.03), Le(0.03)] = 0.0
    scale: Annotated[float, Ge(0.97), Le(1.03)] = 1.0
    gate: Sigmas = 4.0


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Noise model of the camera: deviations grow with the distance to the object.

    Attributes:
        lateral: sigma across the line of sight at distance 0 [m].
        lateral_slope: increase of ``lateral`` for each metre of distance.
        depth_factor: sigma along the line of sight, as a multiple of the lateral one.
        angle: sigma of each rotation at distance 0 [rad].
        angle_slope: increase of ``angle`` for each metre of distance [rad/m].
        lasting: sigma of the noise that is correlated from image to image, as a share of the
            independent noise above. 0: each image errs by itself.
        lasting_s: its correlation time [s].
        gate: reject an innovation beyond this many sigma.
        longest_delay: reject an older exposure [s].
        stamp: sigma of its time stamp [s]; it adds the motion in that time to the variance.
        stamp_offset: sigma of a constant error of its stamps [s], which is estimated from the arm's
            own motion. 0: the stamps are exact.
        bias: sigma of a constant bias for each metre of range, across and along the line of sight,
            which is estimated as the range changes [m/m]. 0: it has none.
        blind_below: distance from the tcp to the object below which it may give no poses [m]. The
            last waypoint before contact is moved out to 20 mm before it: there the tool waits.
        felt: along x and y of the tcp, where the object is felt beyond where the camera shows it
            [m]: an error of the hand-eye calibration that earlier touches have shown.
        felt_depth: the same along z of the tcp [m].
        felt_turn: about x and y of the tcp, by how much it is felt turned from what the camera
            shows [rad]: the same error's turn.
    """

    lateral: Length = 0.00025
    lateral_slope: Slope = 0.0012
    depth_factor: Annotated[float, Ge(0.1), Le(20.0)] = 2.0
    angle: Angle = 0.0006
    angle_slope: Slope = 0.004
    lasting: Annotated[float, Ge(0.0), Le(2.0)] = 0.0
    lasting_s: Constant = 0.5
    gate: Sigmas = 5.0
    longest_delay: Annotated[float, Gt(0.0), Le(1.0)] = 0.3
    stamp: Annotated[float, Ge(0.0), Le(0.1)] = 0.0005
    stamp_offset: Annotated[float, Ge(0.0), Le(0.1)] = 0.01
    bias: Annotated[float, Ge(0.0), Le(0.1)] = 0.001
    blind_below: Annotated[float, Ge(0.0), Le(0.5)] = 0.06
    felt: tuple[Correction, Correction] = (0.0, 0.0)
    felt_depth: Correction = 0.0
    felt_turn: tuple[Turn, Turn] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TactileNoise:
    """The force-torque sensor as a deflection of the elastic mount.

    Attributes:
        deflection: sigma of each translation [m].
        angle: sigma of each rotation [rad].
        stiffness: of the mount along tcp x, y, z [N/m].
        rotational_stiffness: about tcp x, y, z [Nm/rad].
        gate: reject an innovation beyond this many sigma; wide, for steps here are real (1.5 mrad
            by the screws, a stop) and the device's CRC rejects corrupt data.
        contact_force: least force of a contact [N].
        overload_force: force beyond which the tool is withdrawn [N].
        stamp: sigma of its time stamp [s].
        compliance: times the sigma of a deflection with which it moves the target. 1 follows it at
            once, and drives a body that gives way.
        holds: the touch holds the object across the tool's axis: a clamp closes, or bolts or a
            centring take it. False for faces that can slide until the screws are fixed: a force
            across does not show where the object is.
        clamps: the tool's clamp closes on the object at the touch. False for a gripper that holds
            the part alone: until the screws turn a retreat keeps it closed, and takes the part off.
    """

    deflection: Length = 0.00005
    angle: Angle = 0.0002
    stiffness: tuple[Stiffness, Stiffness, Stiffness] = (50e3, 50e3, 50e3)
    rotational_stiffness: tuple[TurningStiffness, TurningStiffness, TurningStiffness] = (
        2000.0,
        2000.0,
        2000.0,
    )
    gate: Sigmas = 20.0
    contact_force: Force = 15.0
    overload_force: Force = 350.0
    stamp: Annotated[float, Ge(0.0), Le(0.1)] = 0.0003
    compliance: Annotated[float, Ge(1.0), Le(1000.0)] = 12.0
    holds: bool = True
    clamps: bool = True


@dataclass(frozen=True, slots=True)
class PayloadSettings:
    """What hangs on the elastic mount: tool and wheel.

    Attributes:
        mass: on the mount [kg]. 0: the mean force before contact counts as weight if it is along
            gravity and larger than a bias. 0 as well if the tcp was measured with it on the mount,
            in the nominal orientation.
        centre: its centre of gravity in the tcp [m].
        part_mass: what the object keeps of it [kg]. Once the screws are fixed the object takes
            that weight over, before the clamp opens. 0: not known.
        bolts: length of bolts or pins that enter before the face touches [m]. A force felt over
            that way is contact only if it is as large as a face's.
        bolt_angle: by which their angle about the object's axis may be off to each side, unseen by
            the camera [rad]. A tool whose bolts do not enter tries again, turned by shares of it.
        bolt_play: between the axes of a bolt and its hole when they touch [m]: half the difference
            of the diameters. A force across shows the object's place while the bolts are in their
            holes. 0: it is not used.
    """

    mass: Annotated[float, Ge(0.0), Le(2000.0)] = 0.0
    centre: tuple[Lever, Lever, Lever] = (0.0, 0.0, 0.0)
    part_mass: Annotated[float, Ge(0.0), Le(2000.0)] = 0.0
    bolts: Annotated[float, Ge(0.0), Le(0.3)] = 0.0
    bolt_angle: Annotated[float, Ge(0.0), Le(0.3)] = 0.0
    bolt_play: Annotated[float, Ge(0.0), Le(0.01)] = 0.0


@dataclass(frozen=True, slots=True)
class SwingMode:
    """One swing of the object on its hanger, about an axis of the nominal object frame.

    Attributes:
        axis: 0, 1 or 2, rotation about x, y or z of the nominal frame.
        frequency_hz: natural frequency of the swing [Hz].
        damping: damping ratio, share of critical.
        levers: displacement of the object for each radian of swing, x y z [m/rad].
        spread: one sigma of the frequency, as a share; the error is estimated while the object is
            seen. 0: the frequency is exact.
        gain: acceleration of the object by the levers, as a share of the conveyor's acceleration
            against which it acts: each stop and start excites it. 0: they do not.
        gain_deviation: one sigma of that gain.
    """

    axis: Annotated[int, Ge(0), Le(2)] = 1
    frequency_hz: Frequency = 0.62
    damping: Annotated[float, Ge(0.0), Lt(0.5)] = 0.002
    levers: tuple[Lever, Lever, Lever] = (-0.3, 0.0, -0.9)
    spread: Annotated[float, Ge(0.0), Le(0.2)] = 0.03
    gain: Annotated[float, Ge(0.0), Le(2.0)] = 0.0
    gain_deviation: Annotated[float, Ge(0.0), Le(1.0)] = 0.0

    @property
    def lever(self) -> float:
        """Displacement of the object for each radian, at least 1 m/rad.

        An object that shifts without a turn has the longest lever, and its angle is small.
        """
        return max(math.hypot(*self.levers), 1.0)


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """Process noise of the filters.

    Attributes:
        position: random walk of the object across the conveyor [m/sqrt(s)].
        angle: random walk of its orientation [rad/sqrt(s)].
        seating: random walk of the orientation while the screws seat the tool [rad/sqrt(s)].
        swing: random walk of the swing's amplitude [rad/sqrt(s)].
        pace: random walk of the swing's frequency, as a share of it [1/sqrt(s)].
        speed: random walk of the conveyor's speed while running [m/s/sqrt(s)].
        ripple: deviation of the conveyor's speed ripple [m/s].
        ripple_time: its correlation time [s].
        contact_ripple: the same while the tool touches the object [m/s]: a sensor that sees
            0.05 mm sees every ripple, and a generic one needs no frequency and costs nothing there.
        contact_ripple_time: its correlation time [s].
        offset: random walk of the distance sensor's offset [m/sqrt(s)].
        slip: one sigma of the way that the distance sensor reads too much, as a share: its wheel
            slips, or has another size. It is estimated. 0: its scale is exact.
        slip_walk: random walk of that share while the conveyor runs [1/sqrt(s)].
        askew: one sigma of the conveyor's direction against y of the nominal object's frame, as the
            object's way in x and in z for each metre; it is estimated. 0: the direction is exact.
        askew_walk: random walk of that direction [1/sqrt(s)].
        initial_images: images whose median starts the filter.
    """

    position: Walk = 0.0001
    angle: Walk = 0.0002
    seating: Walk = 0.001
    swing: Walk = 0.0001
    pace: Walk = 0.0005
    speed: Walk = 0.0005
    ripple: Walk = 0.0003
    ripple_time: Constant = 1.0
    contact_ripple: Walk = 0.001
    contact_ripple_time: Constant = 0.2
    offset: Walk = 0.00002
    slip: Annotated[float, Ge(0.0), Le(0.1)] = 0.003
    slip_walk: Annotated[float, Ge(0.0), Le(0.01)] = 0.0001
    askew: Annotated[float, Ge(0.0), Le(0.1)] = 0.005
    askew_walk: Annotated[float, Ge(0.0), Le(0.01)] = 0.0001
    initial_images: Annotated[int, Ge(1), Le(50)] = 5


@dataclass(frozen=True, slots=True)
class RippleSettings:
    """Periodic part of the conveyor's ripple, by a drive or a chain.

    Attributes:
        frequency_hz: frequency at full conveyor speed [Hz].
        spread: one sigma of the frequency, as a share; the error is estimated while the conveyor
            runs. 0: the frequency is exact.
        deviation: one sigma of its amplitude [m]; 0 for a conveyor without.
        walk: random walk of the amplitude [m/sqrt(s)].
        pace: random walk of the frequency, as a share of it [1/sqrt(s)].
    """

    frequency_hz: Frequency = 1.2
    spread: Annotated[float, Ge(0.0), Le(0.2)] = 0.03
    deviation: Annotated[float, Ge(0.0), Le(0.01)] = 0.00004
    walk: Annotated[float, Ge(0.0), Le(0.001)] = 0.00001
    pace: Annotated[float, Ge(0.0), Le(0.01)] = 0.0005


@dataclass(frozen=True, slots=True)
class RuleSettings:
    """The paper's rule (Sect. III-B).

    Attributes:
        tentative: prediction error at which another class is tried [m].
        confirmed: prediction error at which it is confirmed [m].
        bandwidth: of the speed state the rule's own filter is tuned to [rad/s].
        following: the same of the estimate; above the rule's own, for what the estimate follows
            before a stop is perceived need not be made up for [rad/s].
    """

    tentative: Length = 0.00122
    confirmed: Length = 0.0034
    bandwidth: Annotated[float, Ge(0.1), Le(100.0)] = 6.0
    following: Annotated[float, Ge(0.1), Le(100.0)] = 10.0


@dataclass(frozen=True, slots=True)
class BankSettings:
    """A bank of hypotheses (Willsky's GLR) or of models (IMM).

    Attributes:
        perceived: log odds at which a change counts as perceived.
        stop_confirmed: log odds at which a stop is confirmed.
        contact_confirmed: log odds at which a stop of a running conveyor is confirmed in contact,
            by the force too.
        start_confirmed: log odds at which a start is confirmed.
        amplitude_deviation: of a class's acceleration about its nominal one, a share.
        faster: how likely a change is faster than configured by more than its deviation; 0 knows
            none.
        faster_deviation: of such a one's acceleration [m/s^2].
        as_set: how likely a stop or a start goes on as it was set, which the prediction then takes
            it to, as far as the readings let it; 0 for ramps of which only the other is known.
        as_set_deviation: of such a one's acceleration about its nominal one, a share.
        penalty: taken from a stop's log odds before it enters the mixed prediction.
        contact_penalty: the same in contact.
        contact_caution: factor of what is left of them in contact. 1 is Bayes with the penalty for
            a prior; more lets little evidence count less and much evidence more, so that a
            quiet line is not followed as if it braked a little all the time.
        longest_onset: age of the oldest onset in the bank [s].
    """

    perceived: LogOdds = 6.0
    stop_confirmed: LogOdds = 12.0
    contact_confirmed: LogOdds = 5.5
    start_confirmed: LogOdds = 17.0
    amplitude_deviation: Annotated[float, Ge(0.01), Le(2.0)] = 0.15
    faster: Annotated[float, Ge(0.0), Le(0.5)] = 0.01
    faster_deviation: Annotated[float, Ge(0.001), Le(2.0)] = 0.1
    as_set: Annotated[float, Ge(0.0), Le(0.99)] = 0.8
    as_set_deviation: Annotated[float, Ge(0.001), Le(0.1)] = 0.02
    penalty: LogOdds = 4.0
    contact_penalty: LogOdds = 4.0
    contact_caution: Annotated[float, Ge(0.5), Le(10.0)] = 3.0
    longest_onset: Annotated[float, Ge(0.1), Le(5.0)] = 1.5


@dataclass(frozen=True, slots=True)
class ImpulseSettings:
    """Impulse disturbance of the body, by a hand or a second robot.

    Attributes:
        frequencies_hz: possible swing frequencies of the body along the conveyor.
        damping: damping ratio, share of critical.
        deviation: of the amplitude [m].
        confirmed: log odds at which an impulse is accepted.
        apart: least time between two accepted impulses [s]. What looks like a push so soon after
            another is mostly lost motion or windup of an arm that answers the last one, and each
            answer excites the next.
        longest_onset: age of the oldest onset in the bank [s].
    """

    frequencies_hz: Annotated[tuple[Frequency, ...], Len(1, 8)] = (1.5, 0.5)
    damping: Annotated[float, Ge(0.0), Lt(1.0)] = 0.15
    deviation: Length = 0.002
    confirmed: LogOdds = 6.0
    apart: Annotated[float, Ge(0.0), Le(60.0)] = 1.5
    longest_onset: Annotated[float, Ge(0.05), Le(5.0)] = 0.5

    @property
    def omegas(self) -> tuple[float, ...]:
        """The frequencies [rad/s]."""
        return tuple(2.0 * math.pi * each for each in self.frequencies_hz)


@dataclass(frozen=True, slots=True)
class SwaySettings:
    """Sway of the body along the conveyor, by itself and by stops and starts.

    Attributes:
        is_on: it is looked for and followed.
        frequency_hz: natural frequency, as ``identify`` finds it in recorded stops; 0 if unknown.
        spread: one sigma of that frequency, as a share.
        gain: share of the conveyor's acceleration that excites it, as identified: 1 for a
            pendulum, 0 if unknown.
        gain_deviation: one sigma of that gain, as identified. With an unknown frequency it is that
            of the slowest sway of ``range_hz``, and a faster one moves the body no farther. 1:
            nothing is known, so that each stop that no image has shown is looked at.
        damping: damping ratio, share of critical.
        range_hz: lowest and highest frequency at which it is looked for.
        step: of the frequencies that are tried, as a share.
        memory: time constant of what is remembered of it [s].
        found: log odds at which a sway counts as found.
        least: amplitude from which it is followed [m].
        contact_least: the same in contact, where the force-torque sensor sees it [m].
        walk: random walk of the sway, as a share of its amplitude [1/sqrt(s)].
        pace: random walk of its frequency, as a share of it [1/sqrt(s)].
        driven: random walk by the tool's force in contact [m/sqrt(s)]. 30 N for 0.2 s set 900 kg
            in motion by 7 mm/s, which sways by 1 mm at 1.2 Hz. Without it that is a push.
    """

    is_on: bool = True
    frequency_hz: Annotated[float, Ge(0.0), Le(10.0)] = 0.0
    spread: Annotated[float, Ge(0.001), Le(0.2)] = 0.02
    gain: Annotated[float, Ge(0.0), Le(2.0)] = 0.0
    gain_deviation: Annotated[float, Ge(0.0001), Le(1.0)] = 1.0
    damping: Annotated[float, Ge(0.0), Lt(0.5)] = 0.01
    range_hz: tuple[Frequency, Frequency] = (0.35, 5.5)
    step: Annotated[float, Ge(0.01), Le(0.5)] = 0.1
    memory: Constant = 4.0
    found: LogOdds = 8.0
    least: Length = 0.0003
    contact_least: Length = 0.0001
    walk: Annotated[float, Ge(0.0), Le(1.0)] = 0.03
    pace: Annotated[float, Ge(0.0), Le(0.1)] = 0.005
    driven: Annotated[float, Ge(0.0), Le(0.05)] = 0.002


@dataclass(frozen=True, slots=True)
class ImmSettings:
    """The interacting multiple model filter.

    Attributes:
        rate: of stops and of starts, prior [1/s].
        perceived: odds of another class at which a change counts as perceived.
        confirmed: and at which it is confirmed.
    """

    rate: Annotated[float, Ge(1e-4), Le(10.0)] = 0.1
    perceived: Annotated[float, Gt(0.0), Lt(1.0)] = 0.8
    confirmed: Annotated[float, Gt(0.0), Lt(1.0)] = 0.995


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """Merge of a new prediction into the horizon.

    Attributes:
        along: time constant along the conveyor [s]; of a clamped tool 0.62 times that.
        across: time constant of the other axes [s].
        blend: time in which the programmed motion gives way to the sensed one [s].
    """

    along: Annotated[float, Ge(1e-4), Le(1.0)] = 0.027
    across: Annotated[float, Ge(1e-4), Le(1.0)] = 0.04
    blend: Annotated[float, Ge(1e-3), Le(1e6)] = 2.5  # an exercise never blends


@dataclass(frozen=True, slots=True)
class TrackingSettings:
    """All settings of tracking.

    Attributes:
        classifier: of the conveyor's motion.
        predict: False freezes the horizon at the present estimate (ablation ``no-prediction``).
        mixture: the bank's prediction weighs its hypotheses; False takes the class in force.
    """

    distance: DistanceNoise = DistanceNoise()
    camera: CameraNoise = CameraNoise()
    tactile: TactileNoise = TactileNoise()
    payload: PayloadSettings = PayloadSettings()
    swing: tuple[SwingMode, ...] = (SwingMode(),)
    fusion: FusionSettings = FusionSettings()
    wave: RippleSettings = RippleSettings()
    classifier: ClassifierKind = ClassifierKind.BANK
    rule: RuleSettings = RuleSettings()
    bank: BankSettings = BankSettings()
    imm: ImmSettings = ImmSettings()
    jerk: ImpulseSettings = ImpulseSettings()
    sway: SwaySettings = SwaySettings()
    merge: MergeSettings = MergeSettings()
    predict: bool = True
    mixture: bool = True

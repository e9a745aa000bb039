"""Every setting of palpate from one root: `Settings()` holds the default of each settings class, with its path.

A function takes its own part, not the root: `estimate(frame, model, settings=Settings().estimate)`. Each class stands
beside the code that reads it, where the unit, the reason and the source of every field are: its comment names a paper
or a measurement, or else the class's docstring says whence its values are. "Tuned" is on captures that the simulator
made, with other seeds than the benchmarks'; "by judgement" is an engineer's estimate that no experiment stands behind.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from fusion.advice.grasp import GraspAdviceSettings
from fusion.advice.next_touch import NextTouchSettings
from fusion.benchmarks.arrays.grasps import GraspNoise
from fusion.benchmarks.printing.tables import BenchSettings
from fusion.benchmarks.real.frames import RealSettings
from fusion.estimation.settings import EstimateSettings
from fusion.modelling import ModelSettings
from fusion.tracking.answer import TrackSettings
from fusion.truth.errors import JudgeSettings
from scenes.evidence.align import AlignSettings
from scenes.evidence.point_pairs import PairSettings
from scenes.evidence.symmetry.near_symmetries import NearSettings
from scenes.evidence.symmetry.symmetry_detection import DetectionSettings
from scenes.geometry.appearance.texture import TextureSettings
from scenes.geometry.distance_field import FieldSettings
from scenes.geometry.mesh_repair import RepairSettings
from scenes.recordings.beliefs import Beliefs
from scenes.robot.tactile import SoftLayer
from scenes.synthesis.grasping.grasps import GraspSearchSettings
from scenes.synthesis.motion import MotionSettings
from scenes.synthesis.noise.presets import PRESETS, NoisePreset
from scenes.synthesis.settings import SynthesisSettings
from touch.answers import LocalizeSettings
from touch.arrays.searches import ArraySearchSettings, PressureSettings
from touch.gels.localize import GelSearchSettings
from touch.gels.skin.calibration import GelCalibrationSettings
from touch.published.answers import AnswerSettings
from touch.published.contact_icp import ContactIcpSettings
from touch.published.optimisers.direct import BoxSettings
from touch.published.optimisers.gradient_descent import GradientDescentSettings
from touch.published.optimisers.levenberg_marquardt import LevenbergMarquardtSettings
from touch.published.optimisers.monte_carlo import MonteCarloSettings
from touch.published.particles.memory_unscented_particle_filter import UnscentedSettings
from touch.published.particles.particle_filters import ParticleFilterSettings
from touch.published.particles.recursion import StoppingSettings
from touch.published.particles.scaling_series import ScalingSettings
from touch.recognition import RecognitionSettings
from touch.wrenches.sphere import IntrinsicSettings
from vision.published.registration import BaselineSettings
from vision.tracking.by_vision import VisionTrackerSettings
from vision.tracking.particles import ParticleTrackerSettings


@dataclass(frozen=True)
class ObjectSettings:
    """What is made of a mesh before anything is sensed."""

    # Mending the mesh, its distance lattice, its symmetries, what is nearly one, and its table of point pairs.
    repair: RepairSettings = field(default_factory=RepairSettings)
    lattice: FieldSettings = field(default_factory=FieldSettings)
    symmetries: DetectionSettings = field(default_factory=DetectionSettings)
    near_symmetries: NearSettings = field(default_factory=NearSettings)
    pairs: PairSettings = field(default_factory=PairSettings)
    # What is printed on it.
    texture: TextureSettings = field(default_factory=TextureSettings)


@dataclass(frozen=True)
class SensesSettings:
    """What each sense makes of a frame, where `estimate` does not hold it."""

    # Contacts from wrenches; colours of gels, from presses of a ball.
    wrenches: IntrinsicSettings = field(default_factory=IntrinsicSettings)
    gel_calibration: GelCalibrationSettings = field(default_factory=GelCalibrationSettings)


@dataclass(frozen=True)
class PublishedSettings:
    """The published methods, to compare with."""

    # Contacts: descents from a start, global searches, filters; and how their ends are read.
    gradient_descent: GradientDescentSettings = field(default_factory=GradientDescentSettings)
    levenberg_marquardt: LevenbergMarquardtSettings = field(default_factory=LevenbergMarquardtSettings)
    contact_icp: ContactIcpSettings = field(default_factory=ContactIcpSettings)
    monte_carlo: MonteCarloSettings = field(default_factory=MonteCarloSettings)
    box: BoxSettings = field(default_factory=BoxSettings)
    particle_filter: ParticleFilterSettings = field(default_factory=ParticleFilterSettings)
    unscented: UnscentedSettings = field(default_factory=UnscentedSettings)
    scaling_series: ScalingSettings = field(default_factory=ScalingSettings)
    stopping: StoppingSettings = field(default_factory=StoppingSettings)
    answers: AnswerSettings = field(default_factory=AnswerSettings)
    # Searches over the readings of taxel arrays.
    arrays: ArraySearchSettings = field(default_factory=ArraySearchSettings)
    # Clouds: registration, ICP within it; tracking by particles.
    registration: BaselineSettings = field(default_factory=BaselineSettings)
    particle_tracker: ParticleTrackerSettings = field(default_factory=ParticleTrackerSettings)


@dataclass(frozen=True)
class SimulationSettings:
    """Captures that are made."""

    # Scenes, the hand's grasps, motion from frame to frame, the skin of fingertips, and the errors of a lab's sensors.
    scenes: SynthesisSettings = field(default_factory=SynthesisSettings)
    grasps: GraspSearchSettings = field(default_factory=GraspSearchSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    skin: SoftLayer = field(default_factory=SoftLayer)
    noise: NoisePreset = field(default_factory=lambda: PRESETS["lab"])


@dataclass(frozen=True)
class Settings:
    """The root."""

    # What cameras, calibrations, fingertips and meshes are believed to be worth: data, no method's settings.
    beliefs: Beliefs = field(default_factory=Beliefs)
    # What is known before sensing, what each sense makes of a frame, and one stage of aligning any of it.
    objects: ObjectSettings = field(default_factory=ObjectSettings)
    senses: SensesSettings = field(default_factory=SensesSettings)
    align: AlignSettings = field(default_factory=AlignSettings)
    # Both senses, one frame and a sequence; vision alone from frame to frame.
    estimate: EstimateSettings = field(default_factory=EstimateSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    track_by_vision: VisionTrackerSettings = field(default_factory=VisionTrackerSettings)
    # Touch alone: where from contacts, from the pressures of arrays, from the images of gels; which object.
    localize: LocalizeSettings = field(default_factory=LocalizeSettings)
    pressures: PressureSettings = field(default_factory=PressureSettings)
    gels: GelSearchSettings = field(default_factory=GelSearchSettings)
    identify: RecognitionSettings = field(default_factory=RecognitionSettings)
    # What follows from an answer: where to touch next, what the grasp is worth; a mesh from many answers.
    next_touch: NextTouchSettings = field(default_factory=NextTouchSettings)
    grasp: GraspAdviceSettings = field(default_factory=GraspAdviceSettings)
    model: ModelSettings = field(default_factory=ModelSettings)
    # Errors against the truth, how much work a benchmark does, when it holds a recorded frame for right, and the errors
    # of its recordings of arrays.
    judge: JudgeSettings = field(default_factory=JudgeSettings)
    bench: BenchSettings = field(default_factory=BenchSettings)
    bench_real: RealSettings = field(default_factory=RealSettings)
    bench_arrays: GraspNoise = field(default_factory=GraspNoise)
    published: PublishedSettings = field(default_factory=PublishedSettings)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)

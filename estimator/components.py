"""The table of components: which tuning constants each has, in records beside the code that uses them."""

from typing import Any, Final, NamedTuple

from tilth.estimator.calibration.assignment import ASSIGNMENT
from tilth.estimator.calibration.calibrate import CALIBRATION
from tilth.estimator.calibration.changes import CHANGES
from tilth.estimator.calibration.drive import DRIVE
from tilth.estimator.calibration.faults import FAULTS
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS
from tilth.estimator.calibration.joint import JOINT
from tilth.estimator.calibration.least_squares import LEAST_SQUARES
from tilth.estimator.calibration.linkage import LINKAGE
from tilth.estimator.calibration.receivers import STANDING_RECEIVER
from tilth.estimator.calibration.records import CALIBRATION_RECORDS
from tilth.estimator.calibration.refusals import REFUSALS
from tilth.estimator.calibration.residuals import RESIDUALS
from tilth.estimator.calibration.roll import GROUND
from tilth.estimator.calibration.stage_words import STAGE
from tilth.estimator.calibration.stages import TALLY
from tilth.estimator.calibration.steering_response import STEERING_RESPONSE
from tilth.estimator.calibration.verdict import VERDICT
from tilth.estimator.diagnosis.consistency import CONSISTENCY
from tilth.estimator.diagnosis.findings import FINDINGS
from tilth.estimator.diagnosis.information import INFORMATION
from tilth.estimator.diagnosis.open_numbers import OPEN_NUMBERS
from tilth.estimator.diagnosis.watch import WATCH
from tilth.estimator.diagnosis.wheel_speed import TYRE_WATCH
from tilth.estimator.driving import DRIVING
from tilth.estimator.filters.drift import DRIFT
from tilth.estimator.filters.fit_covariance import FIT_COVARIANCE
from tilth.estimator.filters.likelihood import LIKELIHOOD
from tilth.estimator.filters.newton import NEWTON
from tilth.estimator.filters.propagation import PROPAGATION
from tilth.estimator.filters.rig_setup import RIG_SETUP
from tilth.estimator.filters.scoring import SEARCH
from tilth.estimator.filters.sensors import heading, position, roll, velocity, yaw_rate
from tilth.estimator.filters.soil_change import SOIL_CHANGE
from tilth.estimator.filters.states import STATE
from tilth.estimator.filters.steady_outputs import STEADY_OUTPUTS
from tilth.estimator.filters.two_step_fit import TWO_STEP_FIT
from tilth.estimator.filters.unknowns import PRIOR
from tilth.estimator.fold import FOLD
from tilth.estimator.methods.learned import LEARNED
from tilth.estimator.methods.open_tracker import OPEN_TRACKER
from tilth.estimator.methods.pem import PEM
from tilth.estimator.methods.steady_state import STEADY_STATE
from tilth.estimator.methods.tracker import TRACKER
from tilth.estimator.methods.two_step import TWO_STEP
from tilth.estimator.models.identifiability import IDENTIFIABILITY
from tilth.estimator.models.linear_analysis import LINEAR_ANALYSIS
from tilth.estimator.models.manoeuvres import MANOEUVRE
from tilth.estimator.models.nonlinear import NONLINEAR
from tilth.estimator.models.planned_run import PLANNED_RUN
from tilth.estimator.models.rolling_terms import ROLLING
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.pose.epoch_clock import EPOCH_CLOCK
from tilth.estimator.pose.latency import LATENCY
from tilth.estimator.pose.lateness import LATENESS
from tilth.estimator.pose.log_time import LOG_TIME
from tilth.estimator.pose.motion_check import MOTION_CHECK
from tilth.estimator.pose.plausibility import PLAUSIBILITY
from tilth.estimator.pose.pose import POSE
from tilth.estimator.pose.position_rate import POSITION_RATE
from tilth.estimator.pose.receiver_checks import RECEIVER_CHECKS
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK
from tilth.estimator.pose.recognition import RECOGNITION
from tilth.estimator.pose.screen import SCREEN
from tilth.estimator.pose.standing import STANDING
from tilth.estimator.pose.turn_rate_lag import TURN_RATE_LAG
from tilth.estimator.pose.wheel_check import WHEEL_CHECK
from tilth.estimator.record.measured_rows import MEASURED_ROWS
from tilth.estimator.record.record_builder import RECORD
from tilth.estimator.record.steady_driving import STEADY_DRIVING
from tilth.estimator.record.windows import WINDOWS
from tilth.estimator.results.advice import ADVICE
from tilth.estimator.results.recommend import RECOMMENDATION
from tilth.estimator.results.reporting import REPORTING
from tilth.estimator.rig.adjustments import ADJUSTMENT
from tilth.estimator.warm_start import WARM_START


class Component(NamedTuple):
    """One row. record: a dataclass, each field of it `tuning.tuned`."""

    name: str  # its file in estimator/
    record: Any


COMPONENTS: Final = (
    Component("models/identifiability", IDENTIFIABILITY),
    Component("models/linear_analysis", LINEAR_ANALYSIS),
    Component("models/manoeuvres", MANOEUVRE),
    Component("models/nonlinear", NONLINEAR),
    Component("models/planned_run", PLANNED_RUN),
    Component("models/rolling_terms", ROLLING),
    Component("pose/aligner", ALIGNMENT),
    Component("pose/epoch_clock", EPOCH_CLOCK),
    Component("pose/latency", LATENCY),
    Component("pose/lateness", LATENESS),
    Component("pose/log_time", LOG_TIME),
    Component("pose/motion_check", MOTION_CHECK),
    Component("pose/plausibility", PLAUSIBILITY),
    Component("pose/pose", POSE),
    Component("pose/position_rate", POSITION_RATE),
    Component("pose/receiver_checks", RECEIVER_CHECKS),
    Component("pose/receiver_track", RECEIVER_TRACK),
    Component("pose/recognition", RECOGNITION),
    Component("pose/screen", SCREEN),
    Component("pose/standing", STANDING),
    Component("pose/turn_rate_lag", TURN_RATE_LAG),
    Component("pose/wheel_check", WHEEL_CHECK),
    Component("record/measured_rows", MEASURED_ROWS),
    Component("record/record_builder", RECORD),
    Component("record/steady_driving", STEADY_DRIVING),
    Component("record/windows", WINDOWS),
    Component("filters/drift", DRIFT),
    Component("filters/fit_covariance", FIT_COVARIANCE),
    Component("filters/likelihood", LIKELIHOOD),
    Component("filters/newton", NEWTON),
    Component("filters/propagation", PROPAGATION),
    Component("filters/rig_setup", RIG_SETUP),
    Component("filters/scoring", SEARCH),
    Component("filters/sensors/heading", heading.SENSOR),
    Component("filters/sensors/position", position.SENSOR),
    Component("filters/sensors/roll", roll.SENSOR),
    Component("filters/sensors/velocity", velocity.SENSOR),
    Component("filters/sensors/yaw_rate", yaw_rate.SENSOR),
    Component("filters/soil_change", SOIL_CHANGE),
    Component("filters/states", STATE),
    Component("filters/steady_outputs", STEADY_OUTPUTS),
    Component("filters/two_step_fit", TWO_STEP_FIT),
    Component("filters/unknowns", PRIOR),
    Component("calibration/assignment", ASSIGNMENT),
    Component("calibration/calibrate", CALIBRATION),
    Component("calibration/changes", CHANGES),
    Component("calibration/drive", DRIVE),
    Component("calibration/faults", FAULTS),
    Component("calibration/initial_guess", INITIAL_GUESS),
    Component("calibration/joint", JOINT),
    Component("calibration/least_squares", LEAST_SQUARES),
    Component("calibration/linkage", LINKAGE),
    Component("calibration/receivers", STANDING_RECEIVER),
    Component("calibration/records", CALIBRATION_RECORDS),
    Component("calibration/refusals", REFUSALS),
    Component("calibration/residuals", RESIDUALS),
    Component("calibration/roll", GROUND),
    Component("calibration/stage_words", STAGE),
    Component("calibration/stages", TALLY),
    Component("calibration/steering_response", STEERING_RESPONSE),
    Component("calibration/verdict", VERDICT),
    Component("rig/adjustments", ADJUSTMENT),
    Component("diagnosis/consistency", CONSISTENCY),
    Component("diagnosis/findings", FINDINGS),
    Component("diagnosis/information", INFORMATION),
    Component("diagnosis/open_numbers", OPEN_NUMBERS),
    Component("diagnosis/watch", WATCH),
    Component("diagnosis/wheel_speed", TYRE_WATCH),
    Component("results/advice", ADVICE),
    Component("results/recommend", RECOMMENDATION),
    Component("results/reporting", REPORTING),
    Component("methods/learned", LEARNED),
    Component("methods/open_tracker", OPEN_TRACKER),
    Component("methods/pem", PEM),
    Component("methods/steady_state", STEADY_STATE),
    Component("methods/tracker", TRACKER),
    Component("methods/two_step", TWO_STEP),
    Component("driving", DRIVING),
    Component("fold", FOLD),
    Component("warm_start", WARM_START),
)

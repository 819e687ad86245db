"""Constants of the step size control that several families of steppers share."""

from __future__ import annotations

FIRST_STEP_RATIO = 0.1  # first step, in units of one over the rate of the motion
MIN_STEP_RATIO = 1e-11  # see solvers.stepper.smallest_step
STEP_SAFETY_FACTOR = 0.9  # of the step that follows from the error estimate
MIN_STEP_CHANGE = 0.2  # next step in units of this one, at least
TARGET_TOLERANCE = 1e-9  # part of a step: a step ends at the requested time if its end is so near
MIN_CONTROLLED_ERROR = 1e-8  # tolerances: a smaller error does not make the next step longer
MIN_RTOL_TIMES_GAP = 3e-18  # rtol that rounding allows near a near miss, times its gap; found by trial
TRUNCATED_STEPS = 12  # steps after a change of the loads that end at the requested time: another change is likely there

"""Diagnostics of runs whose text native FMUs have too: templates with fields for names and numbers.

The runtime of native FMUs contains these texts (:func:`mbfmu.native.layout.declarations`) and fills the fields itself:
fields with a format such as ``{t:.6g}`` with numbers, others with texts, each in the order in which they occur.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mbfmu.mechanics.events import Event
from mbfmu.util.diagnostics import Diagnostic

COARSE_ERROR = 100.0  # tolerances times the growth of errors of the motion: what counts as right in tests
COARSE_TOLERANCE_WARNING = Diagnostic.warning(
    "coarse-tolerance",
    f"the tolerance is {{tolerance:g}}: errors may be about {COARSE_ERROR:g} times the tolerance (in rad, or in "
    "lengths of the mechanism), multiplied by the growth of errors of the motion itself, which is large near unstable "
    "equilibria and in chaotic motions",
    "Repeat the run with a tenth of the tolerance and compare the results",
    subject="tolerance",
)
EXCHANGED_ENERGY_PART = ", {part:.2g} of the {exchanged:.3g} J of energy exchanged"
ENERGY_BALANCE = Diagnostic.warning(
    "energy-balance",
    "the energy error is too large at t = {t:.6g} s: the energy has changed by {change:.3g} J {direction} than the "
    "work done on the mechanism{part}, and more than the tolerance explains{nearest}",
    "The motion after this time may be wrong: reduce the tolerance or use another solver, and compare the results",
    subject="energy_error",
)
SLOW_PASSAGE = Diagnostic.warning(
    "slow-passage",
    "the energy error is too large at t = {t:.6g} s: the energy has changed by {change:.3g} J {direction} than the "
    "work done on the mechanism, which is {part:.2g} of the {passage:.3g} J by which the motion has just passed an "
    "unstable equilibrium, or missed it",
    "The time of the passage and the motion after it may be wrong: reduce the tolerance and compare the results",
    subject="energy_error",
)
INPUT_JUMP = Diagnostic.warning(
    "input-jump",
    "input {name!r} at t = {t:.9g} s: its position differs by {size:.3g} {unit} from the value that its rate gives; "
    "the joint is moved there within the next communication step",
    "Set position and rate consistently, or use a smaller communication step",
)
UNDETERMINED_FORCES = Diagnostic.warning(
    "undetermined-forces",
    "outputs of forces at t = {t:.9g} s are not determined and may be unbounded, because the mechanism is in a "
    "singular configuration or too near to one",
    "Read them at other times, or change the lengths of the loop",
)
LIFTING_WHEEL = Diagnostic.warning(
    "lifting-wheel",
    "wheel {name!r} would lift at t = {t:.9g} s: the surface would have to pull it with {force:.3g} N to keep contact. "
    "The motion from there on is that of a wheel that cannot lift",
    "Reduce speeds, correct the normal of the surface, or use a SlippingWheel, which may lift",
)
SLIPPING_WHEEL = Diagnostic.warning(
    "slipping-wheel",
    "wheel {name!r} would slip at t = {t:.9g} s: without slip it needs a friction force of {force:.3g} N, but friction "
    "transmits at most {limit:.3g} N at the normal force {normal:.3g} N. The motion from there on is that of a wheel "
    "that cannot slip",
    "Reduce the torque, the speed or the slope, increase the friction or the normal force, or use a SlippingWheel, "
    "which may slip",
)
SECOND_CONTACT = Diagnostic.warning(
    "second-contact",
    "wheel {name!r} would touch its profile at a second place at t = {t:.9g} s: it rolls at x = {x:.6g} m, and the "
    "profile at x = {second:.6g} m is {depth:.3g} m inside the wheel. The motion from there on is that of a wheel that "
    "can only touch one place",
    "Use a smaller wheel, or a profile whose troughs have a larger radius of curvature; a wheel that leans needs a "
    "larger one than its radius",
)
TIGHT_TROUGH = Diagnostic.warning(
    "second-contact",
    "wheel {name!r} may touch its profile at two places at t = {t:.9g} s, where the run ends: it rolls at x = {x:.6g} "
    "m, and the trough at x = {trough:.6g} m has a radius of curvature of {radius:.4g} m, while that of the outline of "
    "the wheel there is {outline:.4g} m, as it is inclined",
    "Use a smaller wheel, or a profile whose troughs have a larger radius of curvature; a wheel that leans needs a "
    "larger one than its radius",
)
PROFILE_END = Diagnostic.warning(
    "profile-end",
    "wheel {name!r} touches its profile at x = {x:.6g} m at t = {t:.9g} s, but the profile is given from {low:.6g} to "
    "{high:.6g} m. The motion from there on is that on a straight continuation",
    "Use a longer profile, or state its continuation: a Table with beyond='hold' or beyond='periodic', without "
    "profile_interval",
)
SINGULAR_START = Diagnostic.warning(
    "singular-start",
    "the start is a singular configuration, in which the loops do not determine all rates; the rates nearest to the "
    "given ones are used",
    "Give the rate{plural} of {joints} to choose the branch",
)
MAX_EVENTS, RESTING_BOUNCES = 100, 3  # see TOO_MANY_EVENTS and RESTING_BOUNCE
TOO_MANY_EVENTS = Diagnostic.error(
    "too-many-events",
    f"event {{name!r}} at t = {{t:.9g}} s is the last of {MAX_EVENTS} events within {{within:.2g}} s",
    "Use two events at different values (hysteresis), or let an action change the motion so that the quantity does not "
    "cross the value again at once",
)
RESTING_BOUNCE = Diagnostic.error(
    "resting-bounce",
    "event {name!r} comes to rest at its stop at t = {t:.9g} s: its last bounces are within {within:.2g} s",
    "A Bounce holds what rests on the stop if its sensor is the coordinate of a joint with one coordinate, or a "
    "position or a distance (in large models with the solvers 'adams' and 'hybrid'), in Python and in FMUs that call "
    "Python. Use such a sensor, an elastic stop, such as JointStop or DistanceStop, or a shorter stop time",
)
NATIVE_RESTING_BOUNCE = replace(
    RESTING_BOUNCE,
    remedy="A Bounce of a native FMU holds what rests on the stop if its sensor is the coordinate of a joint with one "
    "coordinate. Use such a sensor, or export the model with --python: there a Bounce holds in small models a position "
    "or a distance, too. Or use an elastic stop, such as JointStop or DistanceStop, or a shorter stop time",
)
MASSLESS_EVENT = Diagnostic.error(
    "no-inertia",
    "event {name!r} moves a coordinate without mass by an impulse at t = {t:.9g} s",
    "Give a mass or inertia to the bodies that move freely",
)
SINGULAR_EVENT = Diagnostic.error(
    "singular-event",
    "event {name!r} at t = {t:.9g} s changes the velocities of a loop in a singular configuration, or too near to one, "
    "where the velocities after the event are not unique",
    "Let the event occur at another position of the loop, or change the lengths of the loop",
)
NOT_LOCKED = Diagnostic.error(
    "not-locked",
    "event {name!r} releases a joint at t = {t:.9g} s that is not locked",
    "Release a joint only after a Lock of this joint, or change the order of the events",
)
PRESCRIBED_LOCK = Diagnostic.error(
    "prescribed-lock",
    "event {name!r} cannot lock a joint at t = {t:.9g} s: drives prescribe its rate",
    "Lock a joint that can move freely, or stop the drive",
)
PRESCRIBED_BOUNCE = Diagnostic.error(
    "prescribed-bounce",
    "event {name!r} cannot bounce at t = {t:.9g} s: drives, loop-closing joints or other stops prescribe the rate of "
    "its sensor",
    "Use a sensor that can move freely, or remove the Bounce",
)
START_BEYOND_STOP = Diagnostic.error(
    "invalid-value",
    "the sensor of event {name!r} is beyond its stop at the start, t = {t:.9g} s",
    "Start on the other side of the stop",
)
RUN_ENDED = Diagnostic.error(
    "run-ended", "event {name!r} has ended the run at t = {t:.9g} s", "Do not step beyond this time"
)


def filled(template: Diagnostic, *, time: float | None = None, subject: str = "", **values: Any) -> Diagnostic:
    """Return a diagnostic of a template, at a time (s) or of no time."""
    text, remedy = template.text.format(**values), template.remedy.format(**values)
    return replace(template, text=text, remedy=remedy, time=time, subject=subject or template.subject)


def describe_earlier_events(events: list[Event], t: float) -> list[Diagnostic]:
    """Return a note if events of given times do not occur because a run starts later, at t (s)."""
    earlier = [event for event in events if event.sensor is None and event.time < t]
    if not earlier:
        return []
    given = ", ".join(f"{event.name!r} (t = {event.time:.9g} s)" for event in earlier)
    text = f"events of times before the start of the run at t = {t:.9g} s do not occur: {given}"
    remedy = "Start the run earlier, or give these events later times"
    return [Diagnostic.note("earlier-event", text, remedy, time=t, subject=earlier[0].name)]

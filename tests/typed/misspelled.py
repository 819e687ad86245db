"""A kernel with a misspelled field, for tests/test_records.py: mypy must refuse it."""

from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, Table, Vec3, f8


class Ball(Record):
    """A ball."""

    mass: f8  # kg
    center: Vec3  # m


@kernel
def moment(ball: Ball) -> float:
    """First moment along x, kg m."""
    return ball.mass * float(ball.center[0])


@kernel
def total(balls: Table[Ball]) -> float:
    """Mass of all, kg."""
    found = 0.0
    for k in range(balls.shape[0]):
        found += balls[k].mas
    return found

"""The steady state solved against the damped motion settling: ``python benchmarks/steady.py``.

The damped run lasts till its slowest mode has decayed to 1e-10 and runs at rtol 1e-10; compile time apart, medians.
Two dampings: that which settles fastest of a round number's choice, and the light one a user without foresight gives.
"""

from __future__ import annotations

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from mbfmu.studies.settling import as_text, settle

CASES: tuple[tuple[str, Model], ...] = (
    ("governor, damping 100 N s/m", Governor(damping=100.0)),
    ("governor, damping 10 N s/m", Governor(damping=10.0)),
    ("pendulum, damping 10 N m s/rad and 100 N s/m", SwingPendulum(swing_damping=10.0, slider_damping=100.0)),
    ("pendulum, damping 1 N m s/rad and 10 N s/m", SwingPendulum(swing_damping=1.0, slider_damping=10.0)),
)


def main() -> None:
    """Print a table a case."""
    for name, model in CASES:
        print(f"{name}:\n{as_text(settle(model, tolerances=(1e-10,)))}\n")


if __name__ == "__main__":
    main()

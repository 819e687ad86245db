"""Publications that several problems are from."""

from __future__ import annotations

from mbfmu.verification.problem import Source

IFTOMM = Source(
    "M. González, D. Dopico, U. Lugrís, J. Cuadrado",
    2006,
    "A benchmarking system for MBS simulation software: problem standardization and performance measurement. Multibody "
    "System Dynamics 16, 179-190 (IFToMM library of computational benchmark problems)",
    "https://doi.org/10.1007/s11044-006-9020-8",
)
IVP_TEST_SET = Source(
    "F. Mazzia, C. Magherini",
    2008,
    "Test set for initial value problem solvers, release 2.4. University of Bari",
    "https://archimede.uniba.it/~testset/",
)
LANDAU = Source("L. D. Landau, E. M. Lifshitz", 1976, "Mechanics, 3rd edition. Pergamon Press, sections 35 to 37")

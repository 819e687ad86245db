"""What the plain PythonFMU slaves of the examples share: variables from one table, with units, and a state to save."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar
from uuid import NAMESPACE_URL, uuid5

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, FmuBuilder, Real

from mbfmu.fmi.description import Experiment, Identity, model_description
from mbfmu.fmi.guards import finalize_at_exit
from mbfmu.modeling.variables import Role, ScalarVariable, Type

Table = dict[Fmi2Causality, dict[str, tuple[float, str, str]]]

VARIABILITY = {
    Fmi2Causality.parameter: Fmi2Variability.fixed,
    Fmi2Causality.input: Fmi2Variability.continuous,
    Fmi2Causality.output: Fmi2Variability.continuous,
}


class DescribedSlave(Fmi2Slave):  # type: ignore[misc]
    """Slave whose variables are attributes that a table names.

    No callback may raise: PythonFMU answers with fmi2Fatal and frees what the host still uses.

    Attributes
    ----------
    FILE
        Where the class is; its name is the model's.
    TEXT
        What the model is.
    EXPERIMENT
        What a host runs by default.
    VARIABLES
        By causality and name: start value, unit and meaning.
    HIDDEN
        Attributes that belong to the state and are no variables.
    """

    FILE: ClassVar[Path]
    TEXT: ClassVar[str]
    EXPERIMENT: ClassVar[Experiment]
    VARIABLES: ClassVar[Table]
    HIDDEN: ClassVar[tuple[str, ...]] = ()
    initializing = False

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        for causality, variables in self.VARIABLES.items():
            for name, (start, *_) in variables.items():
                setattr(self, name, start)
                kind = Boolean if isinstance(start, bool) else Real
                self.register_variable(kind(name, causality=causality, variability=VARIABILITY[causality]))
        finalize_at_exit(self.resources, self.modelName)

    def to_xml(self, _options: dict[str, str] | None = None) -> Any:
        """Return the model description, with the units that PythonFMU leaves out."""
        described = [
            ScalarVariable(
                name=name,
                role=Role(causality.name),
                type=Type.BOOLEAN if isinstance(start, bool) else Type.REAL,
                causality=causality.name,
                variability=VARIABILITY[causality].name,
                description=text,
                unit=unit,
                start=None if causality == Fmi2Causality.output else start,
            )
            for causality, variables in self.VARIABLES.items()
            for name, (start, unit, text) in variables.items()
        ]
        identity = Identity(
            name=self.FILE.stem,
            identifier=self.modelName,
            description=self.TEXT,
            guid=str(uuid5(NAMESPACE_URL, self.FILE.read_text() + Path(__file__).read_text())),
        )
        return model_description(identity, self.EXPERIMENT, described, self.log_categories)

    def begin(self) -> None:
        """Set the outputs at the start, from parameters and inputs."""

    def enter_initialization_mode(self) -> None:
        """Let hosts carry start values from FMU to FMU: outputs follow what is set, from here on."""
        self.initializing = True

    def get_real(self, vrs: list[int]) -> Any:
        """Return reals."""
        if self.initializing:
            self.begin()
        return super().get_real(vrs)

    def exit_initialization_mode(self) -> None:
        """Start."""
        self.begin()
        self.initializing = False

    def _get_fmu_state(self) -> dict[str, Any]:
        """Return the variables and what else the next step needs."""
        return {**super()._get_fmu_state(), **{name: getattr(self, name) for name in self.HIDDEN}}


def build_slave(slave: type[DescribedSlave], path: Path) -> Path:
    """Write the FMU of a slave, and into it this file, which it imports."""
    return Path(FmuBuilder.build_FMU(slave.FILE, path, project_files=[Path(__file__)]))

"""Outcomes of an identification: an estimate with its deviation, or a refusal with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Estimate:
    """An identified value.

    Attributes:
        value: in SI units, unless its name has a unit.
        deviation: standard deviation, in the same unit.
        basis: number and kind of the data.
    """

    value: float
    deviation: float
    basis: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """A value that a recording cannot give.

    Attributes:
        reason: why not, and which recording can.
    """

    reason: str


Outcome = Estimate | Refusal


@dataclass(frozen=True, slots=True)
class ReportLine:
    """One line of the report.

    Attributes:
        name: name of the value, or path of the parameter.
        unit: unit of the shown value.
        scale: from SI to that unit.
    """

    name: str
    unit: str
    scale: float
    outcome: Outcome
    in_overlay: bool = False

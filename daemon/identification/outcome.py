"""What an identification says: a value with its deviation, or a refusal with its reason.

Law of this file: frozen values only. A number without a deviation is not an estimate, and what a
recording cannot tell is refused, never guessed.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value as it was identified.

    Attributes:
        value: in SI units, or as the name of what it is says.
        deviation: one sigma, in the same unit.
        basis: what it rests on.
    """

    value: float
    deviation: float
    basis: str


@dataclass(frozen=True, slots=True)
class Refusal:
    """What a recording does not tell.

    Attributes:
        reason: why, and what would.
    """

    reason: str


Outcome = Estimate | Refusal


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of a report.

    Attributes:
        name: what it is, as a parameter's path where it is one.
        unit: in which it is shown.
        scale: from SI to that unit.
        told: it goes into the overlay.
    """

    name: str
    unit: str
    scale: float
    outcome: Outcome
    told: bool = False

"""Learning the servos anew while running: how fast each axis answers, within bounds.

Law of this file: pure. The window remembers the last seconds of setpoints and answers and is cheap
enough for every cycle; ``learn`` looks at it, off the cycle, and says by how much each axis is
quicker or slower than it was identified. What is learned is bounded twice: never farther from the
identified model than ``reach``, never faster than ``rate``; and an axis that was hardly moved
keeps what it has. Forward only, as in ``servo_fit``: the setpoints carry no noise.

A step is replayed bit for bit, so whoever swaps taps between two steps has to record that he did.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from linemate.daemon.core.control.inverse_filter import servo_inverse, servo_pulse
from linemate.daemon.core.control.settings import FilterSettings, ServoModel
from linemate.daemon.core.horizon import Array

Share = Annotated[float, Gt(0.0), Lt(0.5)]

_STEP = 1e-3  # of ln f, in the numeric derivative
_GAUSS_NEWTON = 2
_OUTLIER = 5.0
_SETTLED = 8.0  # time constants after which an old setpoint no longer counts


@dataclass(frozen=True, slots=True)
class AdaptationSettings:
    """How far, how fast and on what evidence servos are learned anew.

    Attributes:
        window_s: of setpoints and answers that are looked at [s].
        reach: largest change of a frequency from the identified one, as a share.
        rate: largest change of it in a second, as a share.
        noise: of an answer, at least [rad, m]; what is finer is not believed.
        sure: deviation of a frequency, as a share, above which a window tells nothing.
        misfit: share of the lag that the model may leave over and still be believed.
        memory_s: time in which older windows lose their weight [s].
    """

    window_s: Annotated[float, Ge(0.1), Le(60.0)] = 3.0
    reach: Share = 0.3
    rate: Annotated[float, Gt(0.0), Le(1.0)] = 0.03
    noise: Annotated[float, Gt(0.0), Le(0.01)] = 1e-5
    sure: Share = 0.02
    misfit: Annotated[float, Gt(0.0), Le(10.0)] = 0.3
    memory_s: Annotated[float, Ge(0.1), Le(3600.0)] = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The last cycles, oldest first.

    Attributes:
        commands: (m, axes) setpoints in force [rad, m].
        answers: (m, axes) measured at the same cycles' telegrams, NaN where none came [rad, m].
        filled: cycles that have been noted, at most m.
    """

    commands: Array
    answers: Array
    filled: int


@dataclass(frozen=True, slots=True)
class AxisBelief:
    """What is believed of one axis.

    Attributes:
        factor: frequency over the identified one, as it is to be used.
        estimate: the same as the windows say it, not limited by the rate.
        variance: of ``estimate``; the identified model's own doubt at first.
        told: the last window was believed.
        why: it was not, None if it was.
    """

    factor: float = 1.0
    estimate: float = 1.0
    variance: float = 1e-4
    told: bool = False
    why: str | None = None


@dataclass(frozen=True, slots=True)
class Learned:
    """What is believed of all axes.

    Attributes:
        models: to be inverted, one an axis.
    """

    beliefs: tuple[AxisBelief, ...]
    models: tuple[ServoModel, ...]


def empty(settings: AdaptationSettings, axes: int, cycle_s: float) -> Window:
    """Return a window that remembers nothing."""
    m = max(math.ceil(settings.window_s / cycle_s), 1)
    return Window(np.zeros((m, axes)), np.full((m, axes), np.nan), 0)


def note(window: Window, command: Array, answer: Array | None) -> Window:
    """Return the window one cycle on.

    Args:
        command: (axes,) setpoint in force from this cycle's telegram on; the one held, if none
            was sent.
        answer: (axes,) measured in this cycle's telegram, None without one.
    """
    measured = np.full((1, len(command)), np.nan) if answer is None else answer[None]
    return Window(
        np.concatenate((window.commands[1:], command[None])),
        np.concatenate((window.answers[1:], measured)),
        min(window.filled + 1, len(window.commands)),
    )


def initial(identified: Sequence[ServoModel]) -> Learned:
    """Return the belief that every axis still is as it was identified."""
    return Learned(tuple(AxisBelief() for _ in identified), tuple(identified))


def learn(
    settings: AdaptationSettings,
    identified: Sequence[ServoModel],
    learned: Learned,
    window: Window,
    cycle_s: float,
    elapsed: float,
    only: Collection[int] | None = None,
) -> Learned:
    """Return what is believed after one more look at the window.

    Args:
        identified: models of the axes as they were identified, the middle of the bounds.
        learned: what was believed so far.
        cycle_s: T0 [s].
        elapsed: time since the last look, at these axes [s].
        only: axes to look at, a few at a time where a cycle is short; None: all.
    """
    beliefs = tuple(
        _axis(settings, model, belief, window, axis, cycle_s, elapsed)
        if only is None or axis in only
        else belief
        for axis, (model, belief) in enumerate(zip(identified, learned.beliefs, strict=True))
    )
    models = tuple(
        replace(model, frequency_hz=model.frequency_hz * belief.factor)
        for model, belief in zip(identified, beliefs, strict=True)
    )
    return Learned(beliefs, models)


def taps(models: Sequence[ServoModel], filters: FilterSettings, cycle_s: float) -> Array:
    """Return the taps (m, axes) of (12) for learned models; some milliseconds, off the cycle."""
    return np.stack([servo_inverse(model, filters, cycle_s) for model in models], axis=1)


def between(old: Array, new: Array, share: float) -> Array:
    """Return taps on the way from old to new ones, so that a swap makes no step of the command.

    Taps of both sum to 1, and so do all between them: rest stays rest.

    Args:
        share: 0 old, 1 new.
    """
    mixed: Array = old + min(max(share, 0.0), 1.0) * (new - old)
    return mixed


def _axis(
    settings: AdaptationSettings,
    identified: ServoModel,
    belief: AxisBelief,
    window: Window,
    axis: int,
    cycle_s: float,
    elapsed: float,
) -> AxisBelief:
    """Return the belief of one axis after one more look: a scalar filter over windows."""
    looked = _look(settings, identified, belief.estimate, window, axis, cycle_s)
    if isinstance(looked, str):
        return _moved(settings, replace(belief, told=False, why=looked), elapsed)
    factor, variance = looked
    # Older windows fade: a drift is to be followed, and windows that overlap are not independent.
    keep = math.exp(-elapsed / settings.memory_s)
    prior = belief.variance / max(keep, 1e-6)
    share = min(elapsed / settings.window_s, 1.0)
    gain = prior / (prior + variance / max(share, 1e-6))
    estimate = belief.estimate + gain * (factor - belief.estimate)
    told = AxisBelief(
        factor=belief.factor,
        estimate=min(max(estimate, 1.0 - settings.reach), 1.0 + settings.reach),
        variance=max((1.0 - gain) * prior, 1e-10),
        told=True,
    )
    return _moved(settings, told, elapsed)


def _moved(settings: AdaptationSettings, belief: AxisBelief, elapsed: float) -> AxisBelief:
    """Return the belief with its factor moved towards the estimate, no faster than allowed."""
    most = settings.rate * elapsed
    step = min(max(belief.estimate - belief.factor, -most), most)
    return replace(belief, factor=belief.factor + step)


def _look(
    settings: AdaptationSettings,
    identified: ServoModel,
    start: float,
    window: Window,
    axis: int,
    cycle_s: float,
) -> tuple[float, float] | str:
    """Return factor and variance as one window tells them, or why it tells nothing."""
    slowest = replace(identified, frequency_hz=identified.frequency_hz * (1.0 - settings.reach))
    skip = _memory_steps(slowest, cycle_s)
    commands = window.commands[len(window.commands) - window.filled :, axis]
    answers = window.answers[len(window.answers) - window.filled :, axis]
    rows = np.isfinite(answers)
    rows[:skip] = False
    if int(rows.sum()) < 20:
        return "the window is not full yet"
    low, high = math.log(1.0 - settings.reach), math.log(1.0 + settings.reach)
    log_factor = min(max(math.log(start), low), high)

    def left(value: float, kept: NDArray[np.intp]) -> Array:
        model = replace(identified, frequency_hz=identified.frequency_hz * math.exp(value))
        e = (answers - _answer(model, commands, cycle_s))[kept]
        centred: Array = e - e.mean()
        return centred

    kept = np.flatnonzero(rows)
    power = 0.0
    e = left(log_factor, kept)
    for _ in range(_GAUSS_NEWTON):
        slope = (left(log_factor + _STEP, kept) - e) / _STEP
        power = float(slope @ slope)
        if power * settings.sure**2 < settings.noise**2:
            return "the axis hardly moved"
        log_factor = min(max(log_factor - float(slope @ e) / power, low), high)
        e = left(log_factor, kept)
        spread = 1.4826 * float(np.median(np.abs(e)))
        good = np.abs(e) <= max(_OUTLIER * spread, _OUTLIER * settings.noise)
        kept = kept[good]
        e = e[good] - e[good].mean()
    lag = (answers - commands)[kept]
    lag = lag - lag.mean()
    if float(e @ e) > settings.misfit**2 * float(lag @ lag) + len(e) * settings.noise**2:
        return "the model does not explain the answers"
    # What is left is mostly the model's own error and correlated: no more than one independent
    # value a rise time is counted.
    rise = max(0.5 / (identified.frequency_hz * cycle_s), 1.0)
    variance = max(float(e @ e) / len(e), settings.noise**2) * rise / power
    if variance > settings.sure**2:
        return f"the window tells the frequency only to {100.0 * math.sqrt(variance):.0f} %"
    factor = math.exp(log_factor)
    return factor, variance * factor * factor


def _memory_steps(model: ServoModel, cycle_s: float) -> int:
    """Return after how many cycles an old setpoint no longer counts."""
    omega, z = 2.0 * math.pi * model.frequency_hz, model.damping
    slowest = omega * (z - math.sqrt(max(z * z - 1.0, 0.0)))
    return math.ceil((model.dead_time + _SETTLED / slowest) / cycle_s) + 2


def _answer(model: ServoModel, commands: Array, cycle_s: float) -> Array:
    """Return what the axis should answer (m,), had it stood at the first setpoint before."""
    pulse = servo_pulse(model, cycle_s)
    answer: Array = np.convolve(commands - commands[0], pulse)[: len(commands)] + commands[0]
    return answer

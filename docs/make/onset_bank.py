"""Draw docs/onset-bank.png: how a bank of onsets finds a stop. ``python -m docs.make.onset_bank``.

The recursion is written out here on the smallest filter that shows it, position and speed. The
daemon's bank has more states (``daemon/core/tracking/classifiers/onset_bank.py``), the same sums.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

FILE = Path(__file__).resolve().parents[1] / "onset-bank.png"
CYCLE = 0.012  # [s]
SPEED, DECELERATION = 0.106, 0.104  # nominal [m/s, m/s^2]
ONSET, END = 3.0, 3.4  # of the stop and of the run [s]
DEVIATION = 0.00038  # of a reading: 1 mm steps and noise of 0.25 mm [m]
WALK = 0.0005  # of the speed [m/s/sqrt(s)]
LONGEST = 1.5  # age of the oldest onset [s]
PERCEIVED, CONFIRMED = 6.0, 12.0  # log odds
SPREAD = 0.15  # one sigma of the amplitude about 1

F = np.array(((1.0, CYCLE), (0.0, 1.0)))
H = np.array((1.0, 0.0))
Q = np.diag((0.0, WALK**2 * CYCLE))


def readings(seed: int) -> np.ndarray:
    """Return the distance sensor's readings [m] of a conveyor that stops at ``ONSET``."""
    times = np.arange(0.0, END, CYCLE)
    braked = np.clip(times - ONSET, 0.0, SPEED / DECELERATION)
    noise = np.random.default_rng(seed).normal(0.0, 0.00025, len(times))
    return np.round(SPEED * times - 0.5 * DECELERATION * braked**2 + noise, 3)


def run(seed: int) -> dict[str, np.ndarray]:
    """Return innovations, their deviations, log odds, and the last posterior over onsets."""
    x, P = np.array((0.0, SPEED)), np.diag((0.001**2, 0.003**2))
    absorbed = np.zeros((2, 0))  # f: what the null filter has absorbed of each signature
    age, A, B = np.zeros(0), np.zeros(0), np.zeros(0)
    innovations, deviations, odds, onsets, weights = [], [], [], [], []
    for step, reading in enumerate(readings(seed)):
        x, P, absorbed = F @ x, F @ P @ F.T + Q, F @ absorbed
        absorbed = np.column_stack((np.zeros(2), absorbed))  # a hypothesis "now"
        age = np.append(0.0, age + CYCLE)
        A, B = np.append(0.0, A), np.append(0.0, B)
        S = H @ P @ H + DEVIATION**2
        K, innovation = P @ H / S, reading - H @ x
        signature = -0.5 * DECELERATION * age**2
        rho = signature - H @ absorbed
        A, B = A + rho**2 / S, B + rho * innovation / S
        x, P, absorbed = x + K * innovation, P - np.outer(K, H @ P), absorbed + np.outer(K, rho)
        young = age <= LONGEST
        age, A, B, absorbed = age[young], A[young], B[young], absorbed[:, young]
        widened = 1.0 + SPREAD**2 * A  # the amplitude is N(1, SPREAD^2), integrated out
        ratio = (SPREAD**2 * B**2 + 2.0 * B - A) / (2.0 * widened) - 0.5 * np.log(widened)
        total = np.logaddexp.reduce(ratio)
        innovations.append(innovation)
        deviations.append(np.sqrt(S))
        odds.append(total)
        onsets.append(step * CYCLE - age)
        weights.append(np.exp(ratio - total))
    confirmed = next(step for step, value in enumerate(odds) if value > CONFIRMED)
    return {
        "times": np.arange(len(odds)) * CYCLE,
        "innovations": np.array(innovations),
        "deviations": np.array(deviations),
        "odds": np.array(odds),
        "onsets": onsets[confirmed],
        "weights": weights[confirmed],
    }


def draw(seed: int = 3) -> Figure:
    """Return the figure."""
    trace = run(seed)
    shown = trace["times"] > ONSET - 0.5
    times = trace["times"][shown] - ONSET
    figure = Figure(figsize=(9.0, 3.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    left.plot(times, 1e3 * trace["innovations"][shown], ".", ms=3)
    left.plot(times, 2e3 * trace["deviations"][shown], "k:", lw=0.8)
    left.plot(times, -2e3 * trace["deviations"][shown], "k:", lw=0.8)
    left.set(title="innovations of the null filter", ylabel="mm", xlabel="time since the onset, s")
    middle.plot(times, trace["odds"][shown])
    for level, name in ((PERCEIVED, "perceived"), (CONFIRMED, "confirmed")):
        middle.axhline(level, color="k", lw=0.8, ls=":")
        middle.text(-0.48, level + 0.5, name, fontsize=8)
    middle.set(title="log odds of a stop", ylim=(-6.0, 30.0), xlabel="time since the onset, s")
    right.bar(trace["onsets"] - ONSET, trace["weights"], width=0.8 * CYCLE)
    right.axvline(0.0, color="k", lw=0.8, ls=":")
    right.set(title="weights of the onsets", xlabel="onset, s", xlim=(-0.3, 0.3))
    return figure


if __name__ == "__main__":
    draw().savefig(FILE)

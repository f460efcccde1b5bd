"""Errors of the camera: a late stamp, biases with the range, noise that lasts."""

import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from scipy import stats
from transverse_runs import FRAME, GATE, VARIANCE

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across import camera_errors
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.across.transverse_state import TransverseState
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings


class TestCameraErrors:
    """Stamp and bias of the camera, from the arm's own motion."""

    OWN = Transverse(FusionSettings(), (), CameraNoise(stamp_offset=0.01, bias=0.003))

    def estimate(
        self, offset: float, bias: tuple[float, float, float], *, moves: bool = True
    ) -> tuple[TransverseState, Array, Array]:
        """Return the estimate, the errors' estimates and sigmas, after an approach of 4 s."""
        chance = np.random.default_rng(3)
        place, sigma, state = np.array((0.1, 0.0, 0.5)), np.sqrt(VARIANCE), None
        first: list[PoseMeasurement] = []
        for i in range(160):
            t = i * FRAME
            share = min(t / 4.0, 1.0) if moves else 0.0
            rate = 0.25 if moves else 0.0
            # The tool comes nearer along z and follows sideways.
            motion = np.array((0.3 * rate, 0.0, rate, 0.0, 0.0, 0.0))
            distance = 0.55 - 0.35 * share
            sensitivity = np.zeros((6, 4))
            sensitivity[:, 0] = motion * (1.0 if int(t) % 2 == 0 else -1.0)
            sensitivity[:3, 1:] = distance * np.eye(3)
            error = sensitivity @ np.array((offset, *bias))
            seen_at = place + error[:3] + sigma[:3] * chance.standard_normal(3)
            turned = rotations.exp(sigma[3:] * chance.standard_normal(3))
            measured = PoseMeasurement(seen_at, turned, 0.0, VARIANCE, sensitivity)
            if state is None:
                first.append(measured)
                state = self.OWN.initial(first) if len(first) == 5 else None
                continue
            state, _ = self.OWN.correct(self.OWN.predict(state, FRAME), measured, GATE)
            state = self.OWN.correct_along(state, measured, -0.05)
        assert state is not None
        k = slice(self.OWN._camera, self.OWN._camera + 4)
        return state, state.x[k], np.sqrt(np.diag(state.P)[k])

    @pytest.mark.parametrize("offset", [-0.02, 0.0, 0.02])
    def test_the_error_of_a_stamp_is_found_from_the_arms_motion(self, offset: float) -> None:
        _, errors, sigmas = self.estimate(offset, (0.0, 0.0, 0.0))
        assert sigmas[0] < 0.0006
        assert abs(errors[0] - offset) < 3.0 * sigmas[0] + 0.02 * abs(offset)

    def test_a_bias_that_grows_with_the_range_is_found_as_the_range_changes(self) -> None:
        bias = (0.003, -0.002, 0.004)
        state, errors, sigmas = self.estimate(0.0, bias)
        assert np.all(np.abs(errors[1:] - bias) < 3.0 * sigmas[1:])
        assert np.all(sigmas[1:] < 0.0015)
        assert abs(state.x[0] - 0.1) < 0.0006
        assert abs(state.x[1] - 0.5) < 0.0009

    def test_errors_that_are_not_there_are_mostly_taken_back(self) -> None:
        state, errors, _ = self.estimate(0.0, (0.0, 0.0, 0.0))
        believed = self.OWN.believed(self.OWN.doubted(state)).x
        k = self.OWN._camera
        assert np.all(np.abs(believed[k : k + 4]) < 0.2 * np.abs(errors))

    def test_an_error_that_is_surely_there_stays_whole(self) -> None:
        state, errors, _ = self.estimate(0.02, (0.003, -0.002, 0.004))
        doubted = self.OWN.doubted(state)
        believed, k = self.OWN.believed(doubted).x, self.OWN._camera
        assert believed[k : k + 4] == pytest.approx(errors, rel=0.1)
        assert doubted.errors is not None
        assert np.diag(doubted.errors) == pytest.approx(np.diag(state.P)[k : k + 4], rel=0.2)

    def test_an_object_without_errors_is_where_a_filter_without_them_has_it(self) -> None:
        state, _, _ = self.estimate(0.0, (0.0, 0.0, 0.0))
        with mock.patch.object(camera_errors, "NONE_ODDS", 1e9):
            believed = self.OWN.believed(self.OWN.doubted(state))
        k, n = self.OWN._slope, self.OWN._camera + 4
        P, x = state.P, state.x
        gain = np.linalg.solve(P[k:n, k:n], P[k:n])
        assert believed.x[:2] == pytest.approx((x - x[k:n] @ gain)[:2], abs=1e-7)
        assert np.all(np.abs(believed.x[k:n]) < 1e-7)

    def test_a_tool_at_rest_learns_nothing_of_the_stamp(self) -> None:
        _, errors, sigmas = self.estimate(0.02, (0.0, 0.0, 0.0), moves=False)
        assert sigmas[0] > 0.0099
        assert abs(errors[0]) < 1e-9

    def test_a_pose_without_its_errors_is_where_the_object_is(self) -> None:
        state, _, _ = self.estimate(0.02, (0.0, 0.0, 0.0))
        sensitivity = np.zeros((6, 4))
        sensitivity[2, 0] = 0.25
        off = PoseMeasurement(np.array((0.1, 0.0, 0.505)), np.eye(3), 0.0, VARIANCE, sensitivity)
        right = self.OWN.without_errors(state, off)
        assert right.position[2] == pytest.approx(0.5, abs=0.0003)
        assert right.variance[2] > off.variance[2]


class TestLastingNoise:
    """A camera whose images err together for a while."""

    SIGMA, TURNED, TIME_S = 0.4e-3, 0.5e-3, 0.5

    def missed(self, model: Transverse, seed: int) -> float:
        """Return the squared error of x and z over their stated variance, after 3 s."""
        chance = np.random.default_rng(seed)
        place, sigma, lasting = np.array((0.1, 0.0, 0.5)), np.sqrt(VARIANCE), np.zeros(6)
        size = np.array((*(self.SIGMA,) * 3, *(self.TURNED,) * 3))
        kept, state = math.exp(-FRAME / self.TIME_S), None
        first: list[PoseMeasurement] = []
        lasting = size * chance.standard_normal(6)
        for _ in range(120):
            fresh = math.sqrt(1.0 - kept * kept) * size * chance.standard_normal(6)
            lasting = kept * lasting + fresh
            error = lasting + sigma * chance.standard_normal(6)
            turned, far = rotations.exp(error[3:]), (self.SIGMA * np.eye(3), self.TURNED)
            measured = PoseMeasurement(place + error[:3], turned, 0.0, VARIANCE, None, far)
            if state is None:
                first.append(measured)
                state = model.initial(first) if len(first) == 5 else None
                continue
            state = model.predict(state, FRAME)
            state, _ = model.correct(state, measured, GATE, is_camera=True)
        assert state is not None
        off = state.x[:2] - place[[0, 2]]
        return float(off @ np.linalg.solve(state.P[:2, :2], off)) / 2.0

    def test_the_stated_error_holds_where_images_err_together(self) -> None:
        camera = CameraNoise(stamp_offset=0.0, bias=0.0, lasting=1.0, lasting_s=self.TIME_S)
        own = Transverse(FusionSettings(), (), camera)
        plain = Transverse(FusionSettings(), (), replace(camera, lasting=0.0))
        seeds = range(100)
        low, high = stats.chi2.ppf((0.001, 0.999), 2 * len(seeds)) / (2 * len(seeds))
        assert low < np.mean([self.missed(own, seed) for seed in seeds]) < high
        assert np.mean([self.missed(plain, seed) for seed in seeds]) > 2.0 * high

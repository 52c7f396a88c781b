# SPDX-License-Identifier: Apache-2.0
"""No sequence of inputs makes a torque beyond its limits, one that is not finite, or a rate beyond its limit.

`make test` tries some hundred sequences, `make properties` (TPGMM_PROPERTY_SEQUENCES=10000) as many as it says.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

pytest.importorskip("pinocchio")

from robots import BAXTER, write_arm
from tpgmm_core import Gaussian
from tpgmm_core.control.control_law import DynamicState
from tpgmm_core.control.impedance import ImpedanceConfig, ImpedanceLaw
from tpgmm_core.control.pose_target import PoseTarget
from tpgmm_core.control.supervised_controller import Answer, SupervisedController
from tpgmm_core.control.supervision import Timeouts
from tpgmm_core.control.torque_limits import injected_power
from tpgmm_core.control.torque_pipeline import TorqueLimits, TorquePipeline
from tpgmm_core.control.yielding import YieldConfig
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

SEQUENCES = int(os.environ.get("TPGMM_PROPERTY_SEQUENCES", "150"))
MS = 1_000_000
#: Rounding of a sum of two torques.
ROUNDING = 1e-12

many = settings(
    max_examples=SEQUENCES,
    derandomize=SEQUENCES < 1000,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture],
)

numbers = st.one_of(
    st.floats(-3.0, 3.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, 1e-300, 1e8, -1e100, 1e300, np.nan, np.inf, -np.inf]),
)
#: Which numbers of a vector are spoiled, and by what; most vectors are left alone.
spoiled = st.one_of(st.just({}), st.just({}), st.dictionaries(st.integers(0, 18), numbers, max_size=3))


@dataclass(frozen=True)
class Event:
    """What happens: `what`, after some time, with a stamp that may lie elsewhere."""

    what: str
    wait_ns: int
    stamp_ns: int = 0  # beside the time of the event
    seed: int = 0
    speed: float = 0.0
    deviation: float = 0.01
    spoiled: dict[int, float] = field(default_factory=dict)
    share: float = 1.0
    force: float | None = None


times = st.one_of(st.just(MS), st.just(MS), st.integers(0, 3 * MS), st.integers(-50 * MS, 400 * MS))
stamps = st.one_of(st.just(0), st.just(0), st.just(0), st.integers(-2000 * MS, 2000 * MS))
seeds = st.integers(0, 7)
runs = st.builds(Event, what=st.just("run"), wait_ns=times, seed=seeds, speed=st.sampled_from([0.0, 0.1, 1.0]))
events = st.one_of(
    runs,
    runs,
    st.builds(
        Event,
        what=st.just("state"),
        wait_ns=times,
        stamp_ns=stamps,
        seed=seeds,
        speed=st.sampled_from([0.0, 0.0, 0.1, 1.0, 20.0]),
        spoiled=spoiled,
    ),
    st.builds(
        Event,
        what=st.just("reference"),
        wait_ns=times,
        stamp_ns=stamps,
        seed=seeds,
        deviation=st.sampled_from([1e-6, 1e-3, 1e-2, 10.0]),
        spoiled=st.one_of(st.just({}), st.dictionaries(st.integers(0, 6), numbers, max_size=2)),
    ),
    st.builds(Event, what=st.just("watch"), wait_ns=times),
    st.builds(Event, what=st.just("refuse"), wait_ns=times),
    st.builds(Event, what=st.just("configure"), wait_ns=times, share=st.floats(0.0, 1.0)),
    st.builds(Event, what=st.just("release"), wait_ns=times),
    st.builds(
        Event, what=st.just("held"), wait_ns=times, seed=seeds, force=st.one_of(st.none(), numbers, st.just(40.0))
    ),
)


class Judge:
    """Plays events to a controller and judges all torques that leave it."""

    def __init__(self, supervised: SupervisedController[PoseTarget], law: ImpedanceLaw) -> None:
        self.supervised, self.law, self.robot = supervised, law, law.robot
        self.judged, self.was_held = 0, False
        self.begin()

    def begin(self) -> None:
        self.supervised.configure(TorqueLimits(), Timeouts(), YieldConfig(yield_force=15.0))
        self.law.configure(ImpedanceConfig())
        self.supervised.start()
        self.now_ns = 1_000_000_000
        self.previous: np.ndarray | None = None
        self.previous_stamp_ns = self.previous_ns = 0

    def play(self, event: Event) -> None:
        if event.what == "run":  # some ordinary steps
            for _ in range(1 + event.seed):
                self.play(replace(event, what="reference", wait_ns=0))
                self.play(replace(event, what="state", wait_ns=MS))
            return
        if event.what == "held":  # a free hand, and a force that may be a person's, beside ordinary steps
            for force in (*[0.0] * 5, *[event.force] * 5):
                self.now_ns += 100 * MS
                self.supervised.take_force(force, self.now_ns)
                self.play(replace(event, what="run", wait_ns=0))
                self.was_held |= self.supervised.guard.yielding.is_held
            return
        self.now_ns = max(0, self.now_ns + event.wait_ns)
        stamp_ns = max(0, self.now_ns + event.stamp_ns)
        rng, robot, supervised = np.random.default_rng(event.seed), self.robot, self.supervised
        if event.what == "state":
            q = rng.uniform(robot.lower_limits, robot.upper_limits) if event.seed > 2 else robot.home.copy()
            v = event.speed * rng.normal(size=robot.nv) * robot.velocity_limits
            for i, value in event.spoiled.items():
                (q if i % 2 else v)[i % robot.nv] = value
            self._judge(supervised.take_state(q, v, stamp_ns, self.now_ns, self.now_ns))
        elif event.what == "reference":
            pose = np.r_[rng.normal(size=3), rng.normal(size=4)]
            for i, value in event.spoiled.items():
                pose[i] = value
            try:
                gaussian = Gaussian(pose, event.deviation**2 * np.eye(6), POSE)
                ahead = tuple(moved(gaussian, rng) for _ in range(event.seed % 2))
                reference = Reference(0.5, gaussian, 0.001, ahead, np.ones(1), ("frame",))
                supervised.take_reference(reference, stamp_ns, self.now_ns, self.now_ns)
            except ValueError as error:
                supervised.refuse_reference(str(error))
        elif event.what == "watch":
            self._judge(supervised.watch(self.now_ns))
        elif event.what == "refuse":
            self._judge(supervised.refuse_state("it lacks joints", stamp_ns, self.now_ns))
        elif event.what == "configure":
            self.law.configure(ImpedanceConfig(max_stiffness=10.0 + 9000.0 * event.share))
            limits = TorqueLimits(torque_rate=0.1 + 900.0 * event.share**3, max_power=1.0 + 1e4 * event.share**4)
            supervised.configure(limits, Timeouts(joint_state_timeout=0.002 + 0.1 * event.share))
        else:
            command, _ = supervised.release(0.001)
            if command is not None:
                self._judge_torque(command.tau, 0.001)

    def _judge(self, answer: Answer | None) -> None:
        if answer is None or (self.previous is not None and answer.command.tau is self.previous):
            return  # silence, or an answer that is sent once more
        # the time that passed, by the stamps or by the clock, whichever is more; a jump back is no time
        passed = max(answer.stamp_ns - self.previous_stamp_ns, self.now_ns - self.previous_ns)
        self.previous_stamp_ns, self.previous_ns = answer.stamp_ns, self.now_ns
        self._judge_torque(answer.command.tau, max(0.0, 1e-9 * passed))

    def _judge_torque(self, tau: np.ndarray, dt: float) -> None:
        limits, effort = self.supervised.controller.pipeline.limits, self.robot.effort_limits
        assert np.isfinite(tau).all()
        assert (np.abs(tau) <= effort).all()
        if self.previous is not None:
            largest = limits.torque_rate * min(dt, limits.max_time_step) * effort
            assert (np.abs(tau - self.previous) <= largest + ROUNDING * effort).all()
        self.previous = tau
        self.judged += 1


def moved(gaussian: Gaussian, rng: np.random.Generator) -> Gaussian:
    """A Gaussian some way off, as the next one of a horizon."""
    return replace(gaussian, mean=POSE.exp(gaussian.mean, 0.01 * rng.normal(size=6)))


def judge_of(robot: RobotModel, endpoint: str) -> Judge:
    law = ImpedanceLaw(robot, endpoint)
    return Judge(SupervisedController(robot, law), law)


@pytest.fixture(scope="module")
def baxter() -> Judge:
    return judge_of(RobotModel.from_file(BAXTER), "left")


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Judge]:
    """Two joints for six dimensions: always singular."""
    path: Path = write_arm(tmp_path_factory.mktemp("arm"))
    yield judge_of(RobotModel.from_file(path), "tool")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # overflow is what is tried
@pytest.mark.parametrize("name", ["baxter", "arm"])
def test_no_sequence_of_inputs_makes_a_torque_or_a_rate_beyond_its_limit(
    name: str, request: pytest.FixtureRequest
) -> None:
    judge: Judge = request.getfixturevalue(name)

    @many
    @given(st.lists(events, min_size=1, max_size=25))
    def sequence(played: list[Event]) -> None:
        judge.begin()
        for event in played:
            judge.play(event)

    sequence()
    assert judge.judged > 3 * SEQUENCES and judge.was_held  # there were torques to judge


vectors = st.lists(st.floats(-60.0, 60.0), min_size=2, max_size=2).map(np.array)


@pytest.mark.parametrize("known", [True, False], ids=["after a torque", "first torque"])
def test_power_is_within_its_limit_or_falls_as_fast_as_the_rate_permits(arm: Judge, known: bool) -> None:
    robot, data = arm.robot, arm.robot.create_data()

    @many
    @given(vectors, vectors, vectors, st.floats(1.0, 100.0), st.floats(0.0, 0.02), st.floats(0.1, 100.0))
    def single(first: np.ndarray, wanted: np.ndarray, v: np.ndarray, power: float, dt: float, rate: float) -> None:
        limits = TorqueLimits(max_power=power, torque_rate=rate, repulsion_margin=0.0)
        pipeline = TorquePipeline(robot, limits)
        moment = DynamicState.at(data, robot.home, 0.1 * v)
        if known:
            pipeline.step(first, moment, 0.02)
            before, _ = pipeline.step(first, moment, 0.02)
        tau, _ = pipeline.step(wanted, moment, dt)
        if injected_power(tau, moment.v, moment.nonlinear) <= power * (1.0 + 1e-9):
            return
        reach = rate * dt * robot.effort_limits if known else np.full(2, np.inf)
        driving = (tau - moment.nonlinear) * moment.v > 1e-9
        lowest = np.clip(
            moment.nonlinear,
            np.maximum(-robot.effort_limits, (before if known else 0.0) - reach),
            np.minimum(robot.effort_limits, (before if known else 0.0) + reach),
        )
        np.testing.assert_allclose(tau[driving], lowest[driving], rtol=1e-9, atol=1e-9)

    single()

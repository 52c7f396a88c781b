# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin

from robots import BAXTER, GRIPPER_URDF, write_arm
from tpgmm_core.control.controller import Controller
from tpgmm_core.control.impedance import ImpedanceLaw
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator


@pytest.fixture(scope="module")
def baxter() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@pytest.fixture
def arm(tmp_path: Path) -> RobotModel:
    return RobotModel.from_file(write_arm(tmp_path))


def test_baxter_has_the_limits_of_its_specification(baxter: RobotModel) -> None:
    assert baxter.nv == 19
    for side in ("left_arm", "right_arm"):
        np.testing.assert_array_equal(baxter.effort_limits[baxter.indices(side)], [50, 50, 50, 50, 15, 15, 15])
    assert baxter.effort_limits.max() == 50.0
    np.testing.assert_array_equal(baxter.viscous_friction, 0.7)


def test_baxter_at_home_holds_its_hands_down_in_front_of_it(baxter: RobotModel) -> None:
    data = baxter.create_data()
    data.update(baxter.home)
    for side, y in (("left", 0.183), ("right", -0.183)):
        pose = data.pose(side)
        np.testing.assert_allclose(pose[:3], [0.58, y, 0.114], atol=1e-3)
        assert quaternion.rotation_matrix(pose[3:])[2, 2] < -0.99  # z of the hand points down


def test_pose_and_twist_are_expressed_in_the_base_frame(arm: RobotModel) -> None:
    data = arm.create_data()
    q, v = arm.ordered(["slide", "turn"], [0.25, np.pi / 2]), arm.ordered(["slide", "turn"], [0.0, 2.0])
    data.update(q, v)
    np.testing.assert_allclose(data.pose("tool")[:3], [0.0, 1.25, 0.0], atol=1e-9)
    np.testing.assert_allclose(quaternion.log(data.pose("tool")[3:]), [0, 0, np.pi / 2], atol=1e-9)
    np.testing.assert_allclose(data.twist("tool"), [-2.5, 0, 0, 0, 0, 2.0], atol=1e-9)
    np.testing.assert_allclose(data.bias_acceleration("tool")[:3], [0.0, -5.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("name", ["baxter", "arm"])
def test_jacobian_and_bias_agree_with_finite_differences(name: str, request: pytest.FixtureRequest) -> None:
    robot: RobotModel = request.getfixturevalue(name)
    endpoint = next(iter(robot.endpoints))
    rng = np.random.default_rng(0)
    q, v = robot.home + 0.1 * rng.normal(size=robot.nv), rng.normal(size=robot.nv)
    data, moved, h = robot.create_data(), robot.create_data(), 1e-6
    data.update(q, v)
    data.mass_matrix(q), data.nonlinear_effects(q, v)  # must not disturb the kinematics
    moved.update(q + h * v, v)
    p0, p1 = data.pose(endpoint), moved.pose(endpoint)
    twist = POSE.log(p0, p1) / h
    np.testing.assert_allclose(data.jacobian(endpoint) @ v, twist, atol=1e-4)
    np.testing.assert_allclose(data.twist(endpoint), data.jacobian(endpoint) @ v, atol=1e-12)
    jacobian_rate = (moved.jacobian(endpoint) - data.jacobian(endpoint)) / h
    np.testing.assert_allclose(data.bias_acceleration(endpoint), jacobian_rate @ v, atol=1e-3)


def energies(robot: RobotModel, q: np.ndarray, v: np.ndarray, h: float = 1e-5) -> tuple[float, float]:
    """Kinetic and potential energy of the links, J, from where they are a little earlier and later."""

    def links(at: np.ndarray) -> list[pin.SE3]:
        data = robot.pinocchio.createData()
        pin.forwardKinematics(robot.pinocchio, data, at)
        return [pin.SE3(placement) for placement in data.oMi]

    kinetic = potential = 0.0
    places = zip(links(q - h * v), links(q), links(q + h * v), robot.pinocchio.inertias, strict=True)
    for before, here, after, inertia in places:
        centre = (after.act(inertia.lever) - before.act(inertia.lever)) / (2.0 * h)
        turn = pin.log3(before.rotation.T @ after.rotation) / (2.0 * h)
        kinetic += 0.5 * (inertia.mass * centre @ centre + turn @ inertia.inertia @ turn)
        potential -= inertia.mass * robot.pinocchio.gravity.linear @ here.act(inertia.lever)
    return kinetic, potential


def test_dynamics_are_those_of_the_energies_of_the_links(baxter: RobotModel) -> None:
    """M from the kinetic energy of moving links, and Lagrange's equation with derivatives of both energies."""
    rng = np.random.default_rng(1)
    q, v = baxter.home, rng.normal(size=19)
    data, h = baxter.create_data(), 1e-5
    M = data.mass_matrix(q).copy()
    assert 0.5 * v @ M @ v == pytest.approx(energies(baxter, q, v)[0], rel=1e-6)
    M_rate = (data.mass_matrix(q + h * v).copy() - data.mass_matrix(q - h * v)) / (2.0 * h)
    slopes = np.empty(19)
    for i, step in enumerate(h * np.eye(19)):
        U = [energies(baxter, at, np.zeros(19))[1] for at in (q - step, q + step)]
        T = [0.5 * v @ data.mass_matrix(at) @ v for at in (q - step, q + step)]
        slopes[i] = ((T[1] - T[0]) - (U[1] - U[0])) / (2.0 * h)
    np.testing.assert_allclose(data.nonlinear_effects(q, v), M_rate @ v - slopes, atol=1e-5)


def test_joints_are_matched_by_name(baxter: RobotModel) -> None:
    shuffled = list(np.random.default_rng(0).permutation(baxter.joint_names))
    values = [baxter.home[baxter.indices([name])[0]] for name in shuffled]
    np.testing.assert_array_equal(baxter.ordered(shuffled, values), baxter.home)


@pytest.mark.parametrize(
    ("names", "values", "message"),
    [
        (["turn"], [0.0], "missing .*slide"),
        (["turn", "slide", "head"], [0.0] * 3, "unknown .*head"),
        (["turn", "slide", "turn"], [0.0] * 3, "twice .*turn"),
        (["turn", "slide"], [0.0], "shape"),
    ],
)
def test_wrong_joint_names_are_refused(arm: RobotModel, names: list[str], values: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        arm.ordered(names, values)
    with pytest.raises(ValueError, match="wheel"):
        arm.indices("wheel")
    with pytest.raises(ValueError, match="wheel"):
        arm.frame_id("wheel")


def test_friction_of_a_joint_replaces_that_of_its_group(arm: RobotModel) -> None:
    np.testing.assert_array_equal(arm.coulomb_friction[arm.indices(["turn", "slide"])], [0.2, 1.0])
    np.testing.assert_array_equal(arm.viscous_friction[arm.indices(["turn", "slide"])], [0.3, 0.1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"urdf": "other.urdf"}, "no URDF"),
        ({"urdf": "package://nowhere/a.urdf"}, "the package .nowhere. .* is not installed"),
        ({"home": None}, "lacks the key .home."),
        ({"colour": "red"}, "unknown key .colour., expected urdf"),
        ({"home": {"turn": 0.0}}, "home lacks .*slide"),
        ({"home": {"turn": 3.0, "slide": 0.1}}, "home of 'turn' is 3"),
        ({"home": {"turn": "left", "slide": 0.1}}, "'home.turn' is 'left', expected a finite number"),
        ({"home": {"turn": 0.0, "slide": 0.1, "wheel": 0.0}}, "home names the unknown joints .*wheel"),
        ({"joint_groups": {"all": ["turn", "wheel"]}}, "unknown joints .*wheel"),
        ({"joint_groups": {"all": "turn"}}, "'joint_groups.all' is 'turn', expected a list of names"),
        ({"joint_groups": {"all": ["turn", "turn"]}}, "twice"),
        ({"endpoints": {"tool": {"frame": "tool", "joints": "legs"}}}, "unknown joint group 'legs'"),
        ({"endpoints": {"tool": {"frame": "claw", "joints": "all"}}}, "no frames .*claw"),
        ({"endpoints": {"tool": "tool"}}, "expected a mapping"),
        ({"endpoints": {"tool": {"frame": "tool"}}}, "'endpoints.tool' lacks the key 'joints'"),
        ({"base_frame": "upper"}, "moves with a joint"),
        ({"base_frame": "floor"}, "no frames .*floor"),
        ({"limits": {"turn": {"power": 3}}}, "unknown key .power."),
        ({"limits": {"turn": {"velocity": 1e6}}}, "velocity limit .* not credible"),
        ({"friction": {"wheel": {"coulomb": 1}}}, "friction names the unknown joints"),
        ({"friction": {"turn": {"coulomb": -1}}}, "friction of 'turn'"),
    ],
)
def test_a_wrong_robot_file_is_refused_with_the_reason(tmp_path: Path, changes: dict, message: str) -> None:
    with pytest.raises(RobotFileError, match=message) as error:
        RobotModel.from_file(write_arm(tmp_path, changes))
    assert "arm.yaml" in str(error.value)


def test_an_incredible_effort_limit_needs_an_override(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match="effort limit 50000 of 'turn' is not credible"):
        RobotModel.from_file(write_arm(tmp_path, effort=50000))
    robot = RobotModel.from_file(write_arm(tmp_path, {"limits": {"turn": {"effort": 5.0}}}, effort=50000))
    assert robot.effort_limits[robot.indices(["turn"])] == 5.0


WITH_GRIPPER = ("</robot>", GRIPPER_URDF)
LIMIT_OF_TURN = '<limit lower="-2" upper="2" effort="10" velocity="2"/>'


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("", "effort limit 0 of 'turn' is not credible"),
        ('<limit lower="-2" upper="2" velocity="2"/>', "effort limit 0 of 'turn' is not credible"),
        ('<limit lower="-2" upper="2" effort="0" velocity="2"/>', "effort limit 0 .* limits: .* locked: "),
        ('<limit lower="-2" upper="2" effort="10"/>', "velocity limit 0 of 'turn' is not credible"),
        ('<limit effort="10" velocity="2"/>', "'turn' may move from 0 to 0"),
        ('<limit lower="2" upper="-2" effort="10" velocity="2"/>', "'turn' may move from 2 to -2"),
        ('<limit lower="-2" upper="2" effort="a" velocity="2"/>', "cannot load the URDF"),
    ],
)
def test_limits_that_a_urdf_lacks_are_asked_for(tmp_path: Path, limit: str, message: str) -> None:
    with pytest.raises(RobotFileError, match=message) as error:
        RobotModel.from_file(write_arm(tmp_path, replace=(LIMIT_OF_TURN, limit)))
    assert "arm.yaml" in str(error.value)


def test_the_robot_file_gives_the_limits_that_a_urdf_lacks(tmp_path: Path) -> None:
    limits = {"turn": {"effort": 5.0, "velocity": 1.0, "lower": -1.0, "upper": 1.5}}
    robot = RobotModel.from_file(write_arm(tmp_path, {"limits": limits}, replace=(LIMIT_OF_TURN, "")))
    turn = robot.indices("turn")[0]
    found = (robot.effort_limits, robot.velocity_limits, robot.lower_limits, robot.upper_limits)
    assert [values[turn] for values in found] == [5.0, 1.0, -1.0, 1.5]


def test_a_continuous_joint_is_one_angle_without_limits(tmp_path: Path) -> None:
    robot, bounded = (RobotModel.from_file(write_arm(tmp_path, turn=kind)) for kind in ("continuous", "revolute"))
    turn = robot.indices("turn")
    assert (robot.lower_limits[turn], robot.upper_limits[turn]) == (-np.inf, np.inf)
    q = robot.ordered(["turn", "slide"], [1.2, 0.1])
    data, expected = robot.create_data(), bounded.create_data()
    for far in (q, q + robot.ordered(["turn", "slide"], [4 * np.pi, 0.0])):
        data.update(far)
        expected.update(q)
        np.testing.assert_allclose(data.pose("tool"), expected.pose("tool"), atol=1e-9)
        np.testing.assert_allclose(data.jacobian("tool"), expected.jacobian("tool"), atol=1e-9)


def test_a_continuous_joint_may_have_limits_of_the_robot_file(tmp_path: Path) -> None:
    limits = {"turn": {"lower": -6.0, "upper": 6.0}}
    robot = RobotModel.from_file(write_arm(tmp_path, {"limits": limits}, turn="continuous"))
    assert robot.upper_limits[robot.indices("turn")] == 6.0
    q = np.array([7.0, 7.0])
    np.testing.assert_array_equal(robot.unwound(q, np.zeros(2)), q)


def test_angles_of_continuous_joints_are_unwound_to_the_nearest_turn(tmp_path: Path) -> None:
    robot = RobotModel.from_file(write_arm(tmp_path, turn="continuous"))
    near, wrapped = (robot.ordered(["turn", "slide"], values) for values in ([3.1, 0.0], [-3.1, 0.4]))
    expected = robot.ordered(["turn", "slide"], [2 * np.pi - 3.1, 0.4])
    np.testing.assert_allclose(robot.unwound(wrapped, near), expected, atol=1e-12)
    np.testing.assert_array_equal(wrapped, robot.ordered(["turn", "slide"], [-3.1, 0.4]))


def test_locked_joints_are_part_of_their_links(tmp_path: Path) -> None:
    home = {"turn": 0.1, "slide": 0.2}
    locked = {"locked": {"grip": 0.01, "grip_too": 0.03}, "home": home}
    free = {"home": {**home, **locked["locked"]}}
    whole, arm = (RobotModel.from_file(write_arm(tmp_path, keys, replace=WITH_GRIPPER)) for keys in (free, locked))
    assert set(arm.joint_names) == {"turn", "slide"}
    data, expected = arm.create_data(), whole.create_data()
    data.update(arm.home)
    expected.update(whole.home)
    np.testing.assert_allclose(
        data.frame_pose(arm.frame_id("thumb")), expected.frame_pose(whole.frame_id("thumb")), atol=1e-12
    )
    both = whole.indices(arm.joint_names)
    np.testing.assert_allclose(
        data.mass_matrix(arm.home), expected.mass_matrix(whole.home)[np.ix_(both, both)], atol=1e-9
    )


@pytest.mark.parametrize(
    ("changes", "replace", "message"),
    [
        ({"locked": {"wheel": 0.0}}, WITH_GRIPPER, "locked names the unknown joints .*wheel"),
        ({"locked": {"slide": 0.1}}, ("", ""), "unknown joints .*slide"),
        ({"locked": {"slide": True}}, ("", ""), "'locked.slide' is True, expected a finite number"),
        (
            {"joint_groups": {"all": ["turn", "grip_too"]}, "home": {"turn": 0, "slide": 0, "grip": 0, "grip_too": 0}},
            WITH_GRIPPER,
            "'tool' is moved by 'grip_too', which has no motor but mimics 'grip'",
        ),
        ({"gravity": [0, 0]}, ("", ""), "'gravity' is .*, expected three numbers"),
        ({"armature": {"turn": {"inertia": -1}}}, ("", ""), "armature of 'turn' must not be negative"),
        ({"armature": {"wheel": {"inertia": 1}}}, ("", ""), "armature names the unknown joints .*wheel"),
        ({}, ('<mass value="0.5"/>', '<mass value="0"/>'), "slide.* move no mass"),
        ({}, ('type="{turn}"'.format(turn="revolute"), 'type="planar"'), "'turn' of arm.urdf is .*one degree"),
        ({}, ("<robot ", '<robot xmlns:xacro="x"><xacro:arm/></robot><robot '), "no XML"),
        ({}, ('<link name="world"/>', '<xacro:arm xmlns:xacro="wiki.ros.org/xacro"/>'), "is a xacro.* expand it"),
    ],
)
def test_what_is_not_supported_is_said(tmp_path: Path, changes: dict, replace: tuple[str, str], message: str) -> None:
    with pytest.raises(RobotFileError, match=message) as error:
        RobotModel.from_file(write_arm(tmp_path, changes, replace=replace))
    assert "arm.yaml" in str(error.value)


def test_grippers_outside_of_the_joint_groups_are_held_by_the_controller(tmp_path: Path) -> None:
    home = {"turn": 0.1, "slide": 0.2, "grip": 0.02, "grip_too": 0.01}
    robot = RobotModel.from_file(write_arm(tmp_path, {"home": home}, replace=WITH_GRIPPER))
    simulator, controller = RobotSimulator(robot), Controller(robot, ImpedanceLaw(robot, "tool"))
    fingers = robot.indices(["grip", "grip_too"])
    for _ in range(300):
        state = simulator.state
        command = controller.step(state.q, state.v, None, 0.001)
        assert command is not None
        simulator.step(command.tau)
    np.testing.assert_allclose(simulator.state.q[fingers], [0.02, 0.01], atol=1e-4)


def test_a_frame_is_the_link_where_a_joint_has_the_same_name(tmp_path: Path) -> None:
    changes = {
        "joint_groups": {"all": ["turn", "tool"]},
        "friction": None,
        "home": {"turn": 0.0, "tool": 0.25},
    }
    robot = RobotModel.from_file(write_arm(tmp_path, changes, replace=('name="slide"', 'name="tool"')))
    data = robot.create_data()
    data.update(robot.home)
    np.testing.assert_allclose(data.pose("tool")[:3], [1.25, 0.0, 0.0], atol=1e-9)


def test_gravity_points_where_the_robot_file_says_in_base_axes(tmp_path: Path) -> None:
    # the base is turned by 90 degrees about z: base y is the -x of the world; the slide runs along base x
    for gravity, weight in (([-9.81, 0, 0], 0.5 * 9.81), ([0, -9.81, 0], 0.0)):
        robot = RobotModel.from_file(write_arm(tmp_path, {"gravity": gravity}))
        tau = robot.create_data().gravity(robot.home)
        assert tau[robot.indices("slide")[0]] == pytest.approx(weight, abs=1e-9)


def test_the_inertia_of_motors_is_felt_by_the_joint(tmp_path: Path) -> None:
    plain = RobotModel.from_file(write_arm(tmp_path))
    geared = RobotModel.from_file(write_arm(tmp_path, {"armature": {"all": {"inertia": 0.3}}}))
    masses = [robot.create_data().mass_matrix(robot.home) for robot in (geared, plain)]
    np.testing.assert_allclose(masses[0] - masses[1], 0.3 * np.eye(2), atol=1e-12)


def test_friction_of_the_urdf_counts_where_the_robot_file_says_nothing(tmp_path: Path) -> None:
    changes = {"friction": {"slide": {"coulomb": 2.0}}}
    path = write_arm(tmp_path, changes, replace=('damping="0.3"', 'damping="0.3" friction="0.4"'))
    robot = RobotModel.from_file(path)
    np.testing.assert_array_equal(robot.coulomb_friction[robot.indices(["turn", "slide"])], [0.4, 2.0])
    np.testing.assert_array_equal(robot.viscous_friction[robot.indices(["turn", "slide"])], [0.3, 0.0])


@pytest.mark.parametrize("content", [None, "[1, 2", "- a list", "\xff"])
def test_unreadable_robot_files_are_refused(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "robot.yaml"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    with pytest.raises(RobotFileError, match="robot.yaml"):
        RobotModel.from_file(path)

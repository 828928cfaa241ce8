"""URDF: the forward kinematics that others read from it, and the way back."""

import io
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from station.errors import InvalidData, InvalidFile
from station.formats.urdf import from_urdf, to_urdf, urdf_values
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint, KinematicTree

examples = settings(max_examples=20, deadline=None)  # a loaded machine is no failure


def random_joint(rng: np.random.Generator, name: str, kind: str, parent: str, child: str, **more: object) -> Joint:
    axis = rng.normal(size=3)
    return Joint(
        name,
        kind,
        parent,
        child,
        axis / np.linalg.norm(axis) if JOINT_TYPES[kind].has_axis else None,
        rng.normal(size=3) if JOINT_TYPES[kind].has_point else None,
        se3.exp(rng.normal(size=6) * 2),
        pitch_m_per_rad=-0.03 if JOINT_TYPES[kind].form_freedoms else None,
        **more,  # type: ignore[arg-type]
    )


def random_tree(seed: int) -> KinematicTree:
    """base - shoulder - elbow - tip, a slide beside them, a bolt, a ball and a nut: all types, limits of each kind."""
    rng = np.random.default_rng(seed)
    joints = (
        random_joint(rng, "pan", "revolute", "base", "shoulder", limits=(-1.5, 2.5)),
        random_joint(rng, "bend", "revolute", "shoulder", "elbow", state_min=-0.5, state_max=1.0),
        random_joint(rng, "turn", "revolute", "elbow", "tip"),
        random_joint(rng, "slide", "prismatic", "base", "drawer"),
        random_joint(rng, "lift", "prismatic", "drawer", "box", limits=(-0.1, 0.4)),
        random_joint(rng, "weld", "rigid", "box", "lid"),
        random_joint(rng, "bolt", "screw", "lid", "nut", limits=(-20.0, 30.0)),
        random_joint(rng, "ball", "spherical", "nut", "socket", state_min=0.0, state_max=1.0),
        random_joint(rng, "thread", "screw", "socket", "cap"),
    )
    parts = ("base", "shoulder", "elbow", "tip", "drawer", "box", "lid", "nut", "socket", "cap")
    return KinematicTree("base", parts, (), (parts,), joints)


def robot(*lines: str) -> str:
    links = "".join(f'<link name="{name}"/>' for name in ("base", "Link_1", "tip"))
    return f'<robot name="r">{links}{"".join(lines)}</robot>'


def joint(kind: str, parent: str = "base", child: str = "Link_1", inside: str = "", name: str = "j1") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


@pytest.mark.parametrize("seed", range(3))
def test_an_independent_reader_gets_the_same_forward_kinematics(seed: int):
    yourdfpy = pytest.importorskip("yourdfpy")
    tree = random_tree(seed)
    text = to_urdf(tree, "made_up")
    urdf = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        q = rng.uniform(-0.1, 0.4, len(tree.columns))
        values = {name: float(value) for name, value in urdf_values(tree, q).items()}
        assert set(urdf.actuated_joint_names) == set(values)
        urdf.update_cfg(values)
        for part, T_base_part in tree.forward(q).items():
            np.testing.assert_allclose(urdf.get_transform(part, "base"), T_base_part, atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_an_independent_reader_gets_limits_and_types(seed: int):
    yourdfpy = pytest.importorskip("yourdfpy")
    text = to_urdf(random_tree(seed), "made_up")
    joints = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False).joint_map
    assert [joints[name].type for name in ("pan", "turn", "slide", "weld", "bolt", "thread", "ball-roll")] == [
        *("revolute", "continuous", "prismatic", "fixed", "revolute", "continuous", "continuous"),
    ]
    assert (joints["bolt-advance"].limit.lower, joints["bolt-advance"].limit.upper) == pytest.approx((-0.9, 0.6))
    assert (joints["pan"].limit.lower, joints["pan"].limit.upper) == (-1.5, 2.5)
    assert (joints["bend"].limit.lower, joints["bend"].limit.upper) == (-0.5, 1.0)
    assert joints["turn"].limit is None


@given(st.integers(0, 2**32 - 1))
@examples
def test_a_tree_reads_back_as_it_was(seed: int):
    tree = random_tree(seed)
    again = from_urdf(to_urdf(tree, "made_up"), "made_up.urdf")
    assert (again.root, again.parts, again.trees) == (tree.root, tree.parts, tree.trees)
    for before, after in zip(tree.joints, again.joints, strict=True):
        assert (after.name, after.type, after.parent, after.child) == (
            *(before.name, before.type, before.parent, before.child),
        )
        np.testing.assert_allclose(after.T_parent_child_zero, before.T_parent_child_zero, atol=1e-14)
        if before.axis_parent is not None:
            np.testing.assert_array_equal(after.axis_parent, before.axis_parent)
        if before.point_parent_m is not None:
            np.testing.assert_array_equal(after.point_parent_m, before.point_parent_m)
        assert after.pitch_m_per_rad == before.pitch_m_per_rad
    assert [joint.limits for joint in again.joints] == [
        *((-1.5, 2.5), (-0.5, 1.0), None, None, (-0.1, 0.4), None, (-20.0, 30.0), None, None),
    ]


def test_values_come_in_batches_also_where_the_angles_lock():
    ball = Joint("ball", "spherical", "a", "b", None, np.zeros(3), np.eye(4))
    tree = KinematicTree("a", ("a", "b"), (), (("a", "b"),), (ball,))
    q = np.array([[0.1, -2.0, 0.3], [0.0, np.pi / 2, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    values = urdf_values(tree, q)
    angles = np.stack([values[f"ball-{name}"] for name in ("yaw", "pitch", "roll")], axis=-1)
    expected = Rotation.from_rotvec(q).as_matrix()
    np.testing.assert_allclose(Rotation.from_euler("ZYX", angles).as_matrix(), expected, atol=1e-14)


ALIKE = """<joint name="n" type="continuous"><parent link="base"/><child link="n-axis"/><axis xyz="0 0 1"/></joint>
<joint name="n-advance" type="prismatic"><parent link="n-axis"/><child link="n-advanced"/><axis xyz="{axis}"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="{of}" multiplier="0.1" offset="{offset}"/></joint>
<joint name="n-zero" type="fixed"><parent link="n-advanced"/><child link="tip"/></joint>"""


@pytest.mark.parametrize(("of", "axis", "offset"), (("n", "0 1 0", "0"), ("m", "0 0 1", "0"), ("n", "0 0 1", "0.5")))
def test_what_mimics_but_is_no_screw_is_refused(of: str, axis: str, offset: str):
    links = "".join(f'<link name="{name}"/>' for name in ("base", "n-axis", "n-advanced", "tip"))
    with pytest.raises(InvalidFile, match="joint 'n-advance' mimics another"):
        from_urdf(f'<robot name="r">{links}{ALIKE.format(of=of, axis=axis, offset=offset)}</robot>', "r.urdf")
    screw = from_urdf(f'<robot name="r">{links}{ALIKE.format(of="n", axis="0 0 1", offset="0")}</robot>', "r.urdf")
    assert [(joint.type, joint.pitch_m_per_rad) for joint in screw.joints] == [("screw", 0.1)]


def test_three_hinges_that_do_not_meet_are_no_ball():
    ball = Joint("ball", "spherical", "a", "b", None, np.zeros(3), np.eye(4))
    text = to_urdf(KinematicTree("a", ("a", "b"), (), (("a", "b"),), (ball,)), "r")
    assert [joint.type for joint in from_urdf(text, "r.urdf").joints] == ["spherical"]
    roll = '<joint name="ball-roll" type="continuous">\n    <origin xyz="0.0 0.0 0.0"'
    assert roll in text
    apart = from_urdf(text.replace(roll, roll.replace("0.0 0.0 0.0", "0.1 0.0 0.0")), "r.urdf")
    assert [joint.type for joint in apart.joints] == ["revolute", "revolute", "revolute", "rigid"]


@pytest.mark.parametrize("pitch", (np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, np.pi / 2 + 1e-12, 1.0, 3.0))
def test_rotations_survive_the_lock_of_the_angles(pitch: float):
    R = se3.exp_so3([0, 0, 0.8]) @ se3.exp_so3([0, pitch, 0]) @ se3.exp_so3([-0.3, 0, 0])
    weld = Joint("weld", "rigid", "a", "b", None, None, se3.pose(R, [1, 2, 3]))
    tree = KinematicTree("a", ("a", "b"), (), (("a", "b"),), (weld,))
    again = from_urdf(to_urdf(tree, "r"), "r.urdf").joints[0]
    np.testing.assert_allclose(again.T_parent_child_zero[:3, :3], R, atol=1e-15)


def test_trackers_with_a_mount_are_links_and_the_others_a_comment():
    slide = Joint("slide", "prismatic", "base", "lid", [1, 0, 0], None, np.eye(4))
    tree = KinematicTree(
        "base", ("base", "base_b", "lid", "lid_b"), (("base", "base_b"), ("lid", "lid_b")), (("base", "lid"),), (slide,)
    )
    text = to_urdf(tree, "r", {"base_b": se3.translation([0, 0, 1])})
    assert "lid_b is also on lid; its mount is not known" in text
    again = from_urdf(text, "r.urdf")
    assert (again.parts, again.rigid_groups, again.trees) == (
        *(("base", "base_b", "lid"), (("base", "base_b"),), (("base", "lid"),)),
    )
    with pytest.raises(InvalidData, match="mount of 'lid', which is no further tracker; have base_b, lid_b"):
        to_urdf(tree, "r", {"lid": np.eye(4)})


def test_trees_that_nothing_connects_float():
    slide = Joint("slide", "prismatic", "box", "drawer", [1, 0, 0], None, np.eye(4))
    tree = KinematicTree("base", ("base", "box", "drawer"), (), (("base",), ("box", "drawer")), (slide,))
    text = to_urdf(tree, "r")
    assert ET.fromstring(text).find("joint[@type='floating']/child").get("link") == "box"
    again = from_urdf(text, "r.urdf")
    assert (again.root, again.trees) == ("base", (("base",), ("box", "drawer")))


def test_a_robot_of_others_has_its_axes_turned_to_the_parent():
    """With the origin a quarter turn about z, the joint's x axis is the parent's y."""
    origin = '<origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><axis xyz="2 0 0"/>'
    text = robot(
        joint("continuous", inside=origin),
        joint("prismatic", "Link_1", "tip", '<limit lower="0" upper="0.2" effort="1" velocity="1"/>', name="J-2"),
    )
    tree = from_urdf(text, "r.urdf")
    turn, slide = tree.joints
    assert (tree.root, tree.parts, slide.name, slide.limits) == ("base", ("base", "link_1", "tip"), "j_2", (0, 0.2))
    np.testing.assert_allclose(turn.axis_parent, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(turn.point_parent_m, [1, 2, 3])
    R = se3.exp_so3([0, 0, np.pi / 2])
    np.testing.assert_allclose(turn.forward(0.3), se3.pose(R @ se3.exp_so3([0.3, 0, 0]), [1, 2, 3]), atol=1e-15)
    np.testing.assert_array_equal(slide.axis_parent, [1, 0, 0])


WELD = joint("fixed", "Link_1", "tip", name="weld")


@pytest.mark.parametrize(
    ("text", "message"),
    (
        ("<robot", "is no XML"),
        ("<model/>", "holds a <model>; want a <robot>"),
        (robot(), r"3 links have no joint above them \(base, link_1, tip\)"),
        (robot(joint("planar"), WELD), "joint 'j1' is planar; can read revolute, continuous, prismatic, fixed"),
        (robot(joint("floating"), WELD), "joint 'j1' is floating"),
        (robot(joint("fixed", child="hand"), WELD), "names the link 'hand', which isn't there"),
        (robot(joint("fixed", inside='<mimic joint="x"/>'), WELD), "'j1' mimics another"),
        (robot(joint("fixed", inside='<origin xyz="0 0"/>'), WELD), "xyz is '0 0'; want 3 finite numbers"),
        (robot(joint("fixed", inside='<origin rpy="0 0 nan"/>'), WELD), "rpy is '0 0 nan'; want 3 finite numbers"),
        (robot(joint("revolute", inside='<axis xyz="0 0 0"/>'), WELD), "the axis has no direction"),
        (robot('<joint name="j1" type="fixed"><parent link="base"/></joint>'), "joint 'j1' has no <child>"),
        (robot('<joint type="fixed"/>'), "a <joint> has no name"),
        (robot(joint("fixed"), joint("fixed", "Link_1", "tip")), "'j1' is named 'j1' here, and so is another"),
        (robot('<link name="link-1"/>', joint("fixed"), WELD), "'link-1' is named 'link_1' here, and so is another"),
        (robot(joint("fixed"), WELD, joint("fixed", "tip", "base", name="back")), "0 links have no joint above them"),
    ),
)
def test_what_is_no_tree_is_refused_by_name(text: str, message: str):
    with pytest.raises(InvalidFile, match="r.urdf.*" + message):
        from_urdf(text, "r.urdf")

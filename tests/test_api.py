"""Claims of the Python interface: what `import station` offers, in whatever order its modules are imported."""

from __future__ import annotations

import ast
import inspect
import pickle
import pydoc
import subprocess
import sys
from dataclasses import MISSING, fields, replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import station
from station.errors import InvalidData, InvalidFile, OutputExists
from station.fit.options import FitOptions

FRAMES = 40
SOURCE = Path(station.__file__).read_text("utf-8")
ORDERS = (
    "import station; station.fit; import station.fit.options",
    "import station.fit; import station.fit.options as options",
    "import station.fit.learner as learner; from station.fit.learner import learn; import station",
    "from station.fit.options import FitOptions; import station; station.fit; import station.fit.options",
    "from station import fit; import station.fit.options; import station; assert fit is station.fit",
    "import importlib, station.fit.options; importlib.reload(station.fit); importlib.reload(station.fit.options)",
)


def ran(program: str) -> str:
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def log_of(angle_rad: np.ndarray) -> station.PoseLog:
    """A door about z through (1, 0, 0), 0.5 m wide, with a millimetre and a hundredth of a radian of noise."""
    rng = np.random.default_rng(4)
    turn = Rotation.from_rotvec(angle_rad[:, None] * [0.0, 0.0, 1.0])
    T = np.zeros((len(angle_rad), 1, 4, 4))
    T[:, 0, :3, :3] = (turn * Rotation.from_rotvec(0.01 * rng.normal(size=(len(angle_rad), 3)))).as_matrix()
    T[:, 0, :3, 3] = [1.0, 0.0, 0.0] + turn.apply([0.5, 0.0, 0.0]) + 0.001 * rng.normal(size=(len(angle_rad), 3))
    T[:, 0, 3, 3] = 1.0
    return station.PoseLog(np.arange(len(angle_rad)) / 30, "camera", ("door",), T)


ANGLE_RAD = np.linspace(0.0, 1.0, FRAMES)


@pytest.fixture(scope="module")
def log() -> station.PoseLog:
    return log_of(ANGLE_RAD)


@pytest.fixture(scope="module")
def fitted(log: station.PoseLog) -> station.Fit:
    return station.fit(log)


def test_importing_station_loads_nothing_else():
    loaded = ran("import sys; import station; print(*sys.modules)").split()
    assert not {"numpy", "scipy", "pydantic", "inspect", "station.fit", "station.logs"} & set(loaded)


@pytest.mark.parametrize("order", ORDERS)
def test_fit_is_a_package_and_can_be_called_in_any_order_of_imports(order: str):
    ran(
        f"{order}\n"
        "import sys\n"
        "assert station.fit is sys.modules['station.fit'] and station.fit.options.FitOptions\n"
        "try:\n    station.fit(None)\nexcept station.StationError as error:\n    assert 'PoseLog' in str(error)\n"
    )


@pytest.mark.parametrize("order", ("import station", "from station.compare import compare; import station"))
def test_compare_is_a_module_and_can_be_called_in_any_order_of_imports(order: str):
    ran(
        f"{order}\n"
        "assert station.compare.Comparison is station.Comparison\n"
        "try:\n    station.compare(None, None)\n"
        "except station.StationError as error:\n    assert 'JointLog' in str(error)\n"
    )


@pytest.mark.parametrize("order", ("import station", "import station.simulate.scene; import station"))
def test_simulate_is_a_package_and_can_be_called_in_any_order_of_imports(order: str):
    ran(
        f"{order}\n"
        "import sys\n"
        "assert station.simulate is sys.modules['station.simulate']\n"
        "assert station.simulate.Simulated is station.Simulated\n"
        "assert len(station.simulate(station.load_tree('lamp'), seed=3).log.t_s) == 100\n"
        "try:\n    station.simulate('lamp')\n"
        "except station.StationError as error:\n    assert 'load_tree' in str(error)\n"
    )


def test_every_name_is_there_documented_and_listed():
    assert set(station.__all__) <= set(dir(station))
    for name in station.__all__:
        assert (getattr(station, name).__doc__ or "").strip(), name
    with pytest.raises(AttributeError, match="module 'station' has no attribute 'fitt'"):
        _ = station.fitt  # type: ignore[attr-defined]


def test_type_checkers_are_told_where_each_name_really_is():
    block = next(node for node in ast.parse(SOURCE).body if isinstance(node, ast.If))
    told = {
        alias.name: str(node.module) for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert set(told) == set(station.__all__)
    for name, module in told.items():
        there, here = getattr(import_module(module), name), getattr(station, name)
        assert here is (sys.modules[module] if name in ("fit", "compare", "simulate") else there)


def test_the_call_takes_the_options_that_there_are_with_their_defaults():
    parameters = inspect.signature(station.fit).parameters
    keywords = {name: p.default for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY}
    assert keywords == {f.name: f.default for f in fields(FitOptions)} and MISSING not in keywords.values()


def test_help_shows_the_signature_and_what_it_means():
    for call, keyword in ((station.fit, "include_reference: "), (station.compare, "same_clock: ")):
        text = pydoc.plain(pydoc.render_doc(call))
        # In the signature, and again in the explanations.
        assert text.count(keyword) == 2 and "Raises:" in text


def test_an_unknown_keyword_is_refused_with_those_that_there_are(log: station.PoseLog):
    with pytest.raises(
        TypeError, match=r"station.fit\(\) has no argument 'joint_type'; it has log, views, method, .*joint_types"
    ):
        station.fit(log, joint_type=("rigid",))  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"station.compare\(\) has no argument 'mesured'; it has .*measured"):
        station.compare(None, None, mesured=None)  # type: ignore[call-arg]


def test_what_is_no_log_is_refused_with_what_to_do(log: station.PoseLog, fitted: station.Fit):
    with pytest.raises(InvalidData, match=r"wants a PoseLog; have a str\n.*read a file with station\.read_pose_log"):
        station.fit("poses.csv")  # type: ignore[arg-type]
    with pytest.raises(InvalidData, match="joint_types is the text 'rigid'; want a sequence of names"):
        station.fit(log, joint_types="rigid")
    with pytest.raises(InvalidData, match="a JointLog for 'detected'; have a Fit; a fit's is its `states`"):
        station.compare(fitted, None)  # type: ignore[arg-type]


def test_the_calls_can_be_sent_to_other_processes():
    for call in (station.fit, station.compare, station.simulate):
        assert pickle.loads(pickle.dumps(call)) is call


def test_keywords_reach_the_fit(log: station.PoseLog):
    fit = station.fit(log, root="door", joint_types=["rigid", "revolute"], criterion="bic")
    assert fit.tree.root == "door"
    assert fit.tree.method["criterion"] == "bic"
    assert set(fit.tree.joints[0].probability or ()) >= {"rigid", "revolute"}
    assert "prismatic" not in (fit.tree.joints[0].probability or ())


def test_a_fit_is_read_back_as_it_was_written(fitted: station.Fit, tmp_path: Path):
    station.write_fit(fitted, tmp_path / "new" / "fit")
    files = {"kinematics.json", "joint_states.csv", "kinematics.urdf", "tree.png", "tree.svg"}
    assert {path.name for path in (tmp_path / "new" / "fit").iterdir()} == files
    again = station.read_fit(tmp_path / "new" / "fit")
    np.testing.assert_array_equal(again.states.q, fitted.states.q)
    np.testing.assert_array_equal(again.states.std, fitted.states.std)
    assert again.states.units == ("rad",)
    tree = station.read_tree(str(tmp_path / "new" / "fit" / "kinematics.json"))
    assert [joint.name for joint in tree.joints] == ["camera__door"] == [joint.name for joint in again.tree.joints]
    np.testing.assert_array_equal(tree.joints[0].axis_parent, fitted.tree.joints[0].axis_parent)


def test_a_fit_without_joints_is_read_back_too(tmp_path: Path):
    still = station.fit(log_of(np.zeros(FRAMES)))
    station.write_fit(still, tmp_path)
    again = station.read_fit(tmp_path)
    assert again.tree.joints == () == again.states.joints
    assert again.tree.rigid_groups == (("camera", "door"),) and len(again.states.t_s) == FRAMES


def test_a_screw_is_written_and_read_back(fitted: station.Fit, tmp_path: Path):
    (joint,) = fitted.tree.joints
    thread = replace(joint, type="screw", pitch_m_per_rad=0.01)
    screw = replace(fitted, tree=replace(fitted.tree, joints=(thread,)))
    station.write_fit(screw, tmp_path)
    assert (tmp_path / "kinematics.urdf").exists()
    assert station.read_fit(tmp_path).tree.joints[0].pitch_m_per_rad == 0.01


def test_a_folder_that_is_occupied_or_none_is_refused_and_left_alone(fitted: station.Fit, tmp_path: Path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputExists, match="isn't empty"):
        station.write_fit(fitted, tmp_path)
    with pytest.raises(station.StationError, match=r"can't write the fit into '.*sub'"):
        station.write_fit(fitted, tmp_path / "mine.txt" / "sub")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    station.write_fit(fitted, tmp_path, force=True)
    assert (tmp_path / "mine.txt").read_text() == "mine" and (tmp_path / "kinematics.json").exists()


def test_files_that_are_missing_or_of_two_fits_are_refused(fitted: station.Fit, tmp_path: Path):
    with pytest.raises(InvalidFile, match=r"has no kinematics\.json: nothing was fitted there yet"):
        station.read_fit(tmp_path)
    station.write_fit(fitted, tmp_path, force=True)
    (tmp_path / "joint_states.csv").write_text("t_s,lid\n0.0,1.0\n")
    with pytest.raises(InvalidFile, match=r"no column camera__door, a joint's of the kinematics\.json beside it"):
        station.read_fit(tmp_path)
    with pytest.raises(InvalidFile, match=r"no tree '.*gone.json'"):
        station.read_tree(tmp_path / "gone.json")
    with pytest.raises(InvalidFile, match=r"no commands '.*gone.csv'"):
        station.read_commands(tmp_path / "gone.csv")


def test_a_fit_is_compared_with_commands_from_a_file(fitted: station.Fit, tmp_path: Path):
    rows = [f"{t:.4f},{q:.6f}" for t, q in zip(fitted.states.t_s, ANGLE_RAD, strict=True)]
    (tmp_path / "commands.csv").write_text("\n".join(["t_s,hinge", *rows]), encoding="utf-8")
    commands = station.read_commands(tmp_path / "commands.csv")
    hinge = station.compare(fitted.states, commands).joints[0]
    assert (hinge.joint, hinge.fitted_joint, hinge.sign, hinge.type) == ("hinge", "camera__door", 1, "revolute")
    # Noise of 0.01 rad in three axes of one pose, less by the position's part; commands hold for one row.
    assert hinge.against_commanded is not None and hinge.against_commanded.rmse < 0.02

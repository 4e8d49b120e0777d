"""Every background flow against its differential equations, and the refusals."""

import json

import numpy as np
import pytest

from qbxstokes.bie.faxen import stokes_polynomials
from qbxstokes.errors import FlowError, SinglePrecisionWarning
from qbxstokes.flows import (
    REGISTRY,
    Flow,
    Linear,
    Paraboloid,
    PolynomialFlow,
    Rotlet,
    Shear,
    Stokeslet,
    Stresslet,
    SumFlow,
    TransformedFlow,
    Uniform,
    UserFlow,
    add_flows,
    build_flow,
    check_regular,
    check_singularities,
    check_stokesian,
    resolve_paths,
)
from qbxstokes.flows.differences import gradient_of, laplacian_of
from qbxstokes.flows.user import load_function
from qbxstokes.flows.values import parse_monomial, rotation_matrix
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid

CUBIC = {
    "type": "polynomial",
    "coefficients": {
        "u1": {"x2^2": 1.0, "x2**3": 1.0, "x2": 2.0},
        "u2": {"x1*x3": 1.0, "1": 3.0, "x1^3": 1.0},
        "u3": {"x1^3": 1.0, "x2^2 x1": -3.0},
    },
}
STRESSLET = [[1.0, 0.5, 0.2], [0.5, -2.0, 0.3], [0.2, 0.3, 1.0]]
TURN = {"axis": [1.0, 2.0, -1.0], "angle": 0.7}
SPECS = [
    {"type": "uniform", "velocity": [1.0, 2.0, 3.0]},
    {"type": "linear", "gradient": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, -6.0]]},
    {"type": "shear", "rate": 2.0},
    {"type": "extension", "rate": 0.5},
    {"type": "extension", "kind": "planar"},
    {"type": "extension", "kind": "biaxial"},
    {"type": "rotation", "angular_velocity": [0.1, 0.2, 0.3]},
    {"type": "paraboloid", "curvature": 0.25},
    {"type": "paraboloid", "curvature": [0.25, -1.0]},
    {"type": "plane_poiseuille", "half_width": 3.0, "speed": 2.0},
    {"type": "tube_poiseuille", "radius": 4.0},
    CUBIC,
    {"type": "stokeslet", "strength": [1.0, -2.0, 0.5], "position": [3.0, 0.0, 1.0]},
    {"type": "rotlet", "strength": [1.0, -2.0, 0.5], "position": [0.0, 3.0, 1.0]},
    {"type": "stresslet", "strength": STRESSLET, "position": [0.0, 0.0, 3.5]},
    {
        "type": "sum",
        "terms": [
            {"type": "shear"},
            {"type": "stokeslet", "strength": [0.0, 1.0, 0.0], "position": [4.0, 0.0, 0.0]},
            CUBIC,
        ],
    },
    {"type": "transformed", "flow": {"type": "shear"}, "factor": -2.0},
    {"type": "wall_stagnation", "rate": 0.5},
    {"type": "wall_stagnation", "kind": "planar"},
    {
        "type": "above_wall",
        "flow": {"type": "stokeslet", "strength": [1.0, 2.0, 0.0], "position": [0.0, 4.0, 0.0]},
    },
]
IDS = [spec["type"] + str(n) for n, spec in enumerate(SPECS)]


def placed(spec):
    return {
        **spec,
        "rotation": TURN,
        "position": [0.3, -0.2, 0.5 + spec.get("position", [0] * 3)[2]],
    }


def points(n=6, seed=0, size=1.0):
    return np.random.default_rng(seed).uniform(-size, size, (n, 3))


# -- equations and derivatives ----------------------------------------------------------------


@pytest.mark.parametrize(
    "spec", [*SPECS, *map(placed, SPECS)], ids=IDS + [f"{i}-placed" for i in IDS]
)
def test_flow_satisfies_the_stokes_equations_and_its_derivatives_are_its_own(spec):
    flow = build_flow(spec)
    x = points(size=0.6)
    step = flow.difference_step(x)
    gradient = flow.gradient(x)
    scale = 1.0 + np.abs(gradient).max()
    assert gradient == pytest.approx(gradient_of(flow.velocity, x, step), abs=1e-11 * scale)
    assert flow.laplacian(x) == pytest.approx(
        laplacian_of(flow.velocity, x, step), abs=1e-9 * scale
    )
    pressure = gradient_of(lambda y: flow.pressure(y)[..., None] * np.eye(3)[0], x, step)[..., 0, :]
    assert flow.laplacian(x) == pytest.approx(pressure, abs=1e-10 * scale)
    stress = flow.stress(x)
    newton = gradient + np.swapaxes(gradient, -1, -2) - flow.pressure(x)[:, None, None] * np.eye(3)
    assert stress == pytest.approx(newton, abs=1e-13 * scale)
    for row in range(3):
        balance = gradient_of(lambda y, row=row: flow.stress(y)[..., row, :], x, step)
        assert np.trace(balance, axis1=-2, axis2=-1) == pytest.approx(0.0, abs=1e-10 * scale)
    report = check_stokesian(flow, radius=1.0)
    assert report.divergence < 1e-13
    assert report.vorticity_of_laplacian < 1e-9
    assert flow.steady


@pytest.mark.parametrize(
    "spec", [*SPECS, *map(placed, SPECS)], ids=IDS + [f"{i}-placed" for i in IDS]
)
def test_specification_rebuilds_the_flow(spec):
    flow = build_flow(spec)
    again = build_flow(flow.spec())
    x = points()
    assert again.velocity(x) == pytest.approx(flow.velocity(x), rel=1e-14, abs=1e-15)
    assert again.degree == flow.degree
    assert again.spec() == flow.spec()


@pytest.mark.parametrize("spec", SPECS, ids=IDS)
def test_moving_turning_scaling_and_shape_of_evaluation(spec):
    flow = build_flow(spec)
    turn = rotation_matrix(TURN)
    x0 = np.array([0.2, 0.1, -0.3])
    x = points(8).reshape(2, 4, 3)
    moved = 2.0 * flow.rotated(turn).shifted(x0)
    inner = (x - x0) @ turn
    tolerance = 1e-13 * (1.0 + np.abs(flow.velocity(inner)).max())
    assert moved.velocity(x) == pytest.approx(2 * flow.velocity(inner) @ turn.T, abs=tolerance)
    general = 2.0 * TransformedFlow(flow, turn, x0)
    for name in ("velocity", "gradient", "laplacian", "vorticity_of_laplacian"):
        expected = getattr(general, name)(x)
        bound = 1e-8 if name == "vorticity_of_laplacian" else 1e-12
        assert getattr(moved, name)(x) == pytest.approx(
            expected, abs=bound * (1 + abs(expected).max())
        )
    assert moved.pressure(x).shape == (2, 4)
    one = flow.velocity(x[0, 0])
    assert one == pytest.approx(flow.velocity(x)[0, 0], rel=1e-14, abs=1e-16)
    assert (flow - flow).velocity(x) == pytest.approx(np.zeros((2, 4, 3)), abs=1e-15)


# -- polynomial flows -------------------------------------------------------------------------


def test_named_flows_are_what_they_say():
    x = np.array([0.5, 2.0, 3.0])
    assert build_flow({"type": "shear"}).velocity(x) == pytest.approx([2.0, 0.0, 0.0])
    assert Paraboloid(0.1).velocity(x) == pytest.approx([1.3, 0.0, 0.0])
    assert Paraboloid([0.1, 0.2]).velocity(x) == pytest.approx([2.2, 0.0, 0.0])
    assert build_flow({"type": "plane_poiseuille", "half_width": 4.0}).velocity(x)[0] == 0.75
    tube = build_flow({"type": "tube_poiseuille", "radius": np.sqrt(26.0), "speed": 2.0})
    assert tube.velocity(x)[0] == pytest.approx(1.0)
    spin = build_flow({"type": "rotation", "angular_velocity": [1.0, 2.0, 3.0]})
    assert spin.velocity(x) == pytest.approx(np.cross([1.0, 2.0, 3.0], x))
    assert build_flow({"type": "extension"}).velocity(x) == pytest.approx([0.5, -1.0, -1.5])
    assert build_flow(CUBIC).velocity(x) == pytest.approx([16.0, 4.625, -5.875])
    assert [build_flow(spec).degree for spec in SPECS[:12]] == [0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 3]


def test_derivatives_are_the_taylor_tensors_at_the_point():
    flow = build_flow(placed(CUBIC))
    assert isinstance(flow, PolynomialFlow)
    x, y = points(5), points(5, seed=1)
    u, a, b, c = flow.derivatives(x)
    expansion = u + np.einsum("nij,nj->ni", a, y) + 0.5 * np.einsum("nijk,nj,nk->ni", b, y, y)
    expansion += np.einsum("nijkl,nj,nk,nl->ni", c, y, y, y) / 6
    assert expansion == pytest.approx(flow.velocity(x + y), abs=1e-12)
    assert np.einsum("nijj->ni", b) == pytest.approx(flow.laplacian(x), abs=1e-12)
    assert [array.shape for array in (u, a, b, c)] == [(5, *(3,) * n) for n in (1, 2, 3, 4)]


def test_no_digits_are_lost_far_downstream():
    flow = build_flow({"type": "paraboloid", "curvature": 0.3})
    near, far = np.array([0.0, 1.1, 0.7]), np.array([1e6, 1.1, 0.7])
    for a, b in zip(flow.derivatives(near), flow.derivatives(far), strict=True):
        assert np.array_equal(a, b)


def test_sums_of_polynomials_collapse_to_one():
    flow = Shear() + Paraboloid(0.5) + 2.0 * Linear(np.diag([1.0, -1.0, 0.0]))
    assert type(flow) is PolynomialFlow
    assert flow.polynomial is flow
    x = points()
    expected = Shear().velocity(x) + Paraboloid(0.5).velocity(x)
    assert flow.velocity(x) == pytest.approx(expected + x * [2.0, -2.0, 0.0])
    stokeslet = Stokeslet([1.0, 0.0, 0.0], [5.0, 0.0, 0.0])
    mixed = add_flows([Shear(), stokeslet, Paraboloid(), Shear() + stokeslet])
    assert isinstance(mixed, SumFlow)
    assert len(mixed.terms) == 3
    assert mixed.polynomial is None
    assert mixed.degree is None
    assert mixed.singular_points.tolist() == [[5.0, 0.0, 0.0]] * 2


def test_monomials():
    assert parse_monomial("1") == (0, 0, 0)
    assert parse_monomial("x2^2") == (0, 2, 0)
    assert parse_monomial("x1*x3**2") == (1, 0, 2)
    assert parse_monomial("x3 x2 x1") == (1, 1, 1)
    assert parse_monomial("x1*x1") == (2, 0, 0)
    for wrong in ("x4", "x1^4", "x1^-1", "2*x1", "__import__('os')", "x1^2*x2^2", "", "x1+x2"):
        with pytest.raises(FlowError, match="monomial"):
            parse_monomial(wrong)


# -- singularities ----------------------------------------------------------------------------


def test_singularities_carry_their_force_torque_and_stresslet():
    """Integrals of the traction over a sphere round the singularity."""
    height, weight = np.polynomial.legendre.leggauss(12)
    angle = 2 * np.pi * np.arange(16) / 16
    radius = np.sqrt(1 - height**2)
    normal = np.stack(
        [
            np.outer(radius, np.cos(angle)),
            np.outer(radius, np.sin(angle)),
            np.outer(height, np.ones(16)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    area = np.repeat(weight * np.pi / 8, 16)
    centre = np.array([1.0, 2.0, 3.0])
    strength = np.array([0.3, -0.4, 0.5])

    def integrals(flow):
        traction = np.einsum("nij,nj->ni", flow.stress(centre + normal), normal)
        u = flow.velocity(centre + normal)
        flux = area @ np.sum(u * normal, axis=1)
        moment = np.einsum("n,ni,nj->ij", area, traction, normal)
        double_layer = np.einsum("n,ni,nj->ij", area, u, normal)
        stresslet = 0.5 * (moment + moment.T) - np.trace(moment) / 3 * np.eye(3)
        stresslet -= double_layer + double_layer.T
        return area @ traction, area @ np.cross(normal, traction), stresslet, flux

    zero, zeros = np.zeros(3), np.zeros((3, 3))
    stokeslet = {"type": "stokeslet", "strength": strength, "position": centre}
    rotlet = {"type": "rotlet", "strength": strength, "position": centre}
    stresslet = {"type": "stresslet", "strength": STRESSLET, "position": centre}
    for spec, force, torque, tensor in (
        (stokeslet, -strength, zero, zeros),
        (rotlet, zero, -strength, zeros),
        (stresslet, zero, zero, STRESSLET),
    ):
        found = integrals(build_flow(spec))
        for value, expected in zip(found, (force, torque, np.array(tensor), 0.0), strict=True):
            assert value == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("k", [0.05, 0.5, 1.0, 3.0, 20.0])
def test_clearance_is_the_distance_to_the_surface(k):
    rng = np.random.default_rng(8)
    axis = np.array([0.6, 0.0, 0.8])
    centre = np.array([0.1, -0.2, 0.3])
    far = max(k, 1.0)
    x = centre + rng.uniform(-2 * far, 2 * far, (12, 3))
    x[0], x[1] = centre, centre + 0.3 * axis
    x[2], x[3] = centre + 1.5 * axis, centre + 0.4 * k * np.array([0.8, 0.0, -0.6])
    found = Spheroid(k).clearance(x, centre, axis)
    height = (x - centre) @ axis
    width = np.linalg.norm(x - centre - height[:, None] * axis, axis=1)
    theta = np.linspace(0.0, np.pi, 200001)
    brute = [
        np.sqrt(((k * np.sin(theta) - w) ** 2 + (np.cos(theta) - h) ** 2).min())
        for w, h in zip(width, height, strict=True)
    ]
    sign = np.where((width / k) ** 2 + height**2 < 1, -1, 1)
    assert found == pytest.approx(sign * brute, abs=1e-4 * k * 1e-2, rel=1e-7)
    several = Spheroid(k).clearance(x, np.stack([centre, centre + 1.0]), np.stack([axis, axis]))
    assert several.shape == (2, 12)
    assert several[0] == pytest.approx(found)


def test_singularity_in_or_near_the_body_is_refused():
    flow = Shear() + Stokeslet([1.0, 0.0, 0.0], [0.0, 0.0, 1.5])
    axis = [0.0, 0.0, 1.0]
    assert check_singularities(flow, [0.0] * 3, axis, Spheroid(0.5)) == pytest.approx(0.5)
    assert check_singularities(Shear(), [0.0] * 3, axis, Spheroid(0.5)) == np.inf
    with pytest.raises(FlowError, match=r"\(0, 0, 1\.5\).*0\.5 from its surface.*more than 0\.6"):
        check_singularities(flow, [0.0] * 3, axis, Spheroid(0.5), minimum=0.6)
    with pytest.raises(FlowError, match="inside the body"):
        check_singularities(flow, [[9.0] * 3, [0.0, 0.1, 0.7]], [axis, axis], Spheroid(0.5))


@pytest.mark.parametrize("k", [0.05, 0.5, 1.0, 1.1, 4.0])
def test_singular_points_that_nobody_declares_are_found_inside_the_body(k):
    rng = np.random.default_rng(3)
    strain = np.diag([1.0, -2.0, 1.0])
    for kind in (Stokeslet, Rotlet, Stresslet):
        axis, centre = rotation.random_axes(1, rng)[0], rng.standard_normal(3)
        across = np.cross(axis, [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        strength = 0.01 * (strain if kind is Stresslet else rng.standard_normal(3))

        def flow(place, kind=kind, strength=strength):
            hidden = kind(strength, place)
            return Shear() + UserFlow(lambda x: hidden.velocity(x))

        # Halfway to the tip or to the rim, a third of the shorter semi-axis off the focal set.
        aside, along = (k / 3.0, 0.5) if k <= 1.0 else (0.5 * k, 0.3)
        inside = centre + aside * across + along * axis
        assert not flow(inside).singular_points_known
        with pytest.raises(FlowError, match="singular inside the body"):
            check_regular(flow(inside), centre, axis, Spheroid(k))
        for factor in (1.02, 1.2):
            check_regular(flow(centre + factor * k * across), centre, axis, Spheroid(k))
            check_regular(flow(centre + factor * axis), centre, axis, Spheroid(k))


def test_regular_flows_pass_whatever_their_size():
    for flow in (Shear(), 1e-9 * Shear(), Uniform([1e6, 0.0, 0.0]) + Shear()):
        hidden = UserFlow(flow.velocity)
        for k in (0.02, 1.0, 20.0):
            check_regular(hidden, [1.0, 20.0, 3.0], [0.6, 0.0, 0.8], Spheroid(k))


# -- user functions ---------------------------------------------------------------------------

USER_FILE = """
import numpy as np

def shear(x):
    return np.stack([x[:, 1], 0 * x[:, 0], 0 * x[:, 0]], axis=1)

def stokeslet(x, strength=1.0):
    r = x - np.array([4.0, 0.0, 0.0])
    d = np.linalg.norm(r, axis=1)[:, None]
    return strength * (np.array([0.0, 1.0, 0.0]) / d + r * r[:, 1:2] / d**3) / (8 * np.pi)

def pulsating(x, t):
    return np.cos(t) * shear(x)

def compressible(x):
    return x

def not_stokesian(x):
    return np.stack([np.sin(x[:, 1]) * x[:, 2], 0 * x[:, 0], 0 * x[:, 0]], axis=1)

def wrong_shape(x):
    return x[0]

def raises(x):
    raise ValueError("no such place")

def not_finite(x):
    return x * np.nan
"""


@pytest.fixture
def user(tmp_path):
    (tmp_path / "my_flow.py").write_text(USER_FILE)

    def make(name, **keys):
        return build_flow({"type": "user", "function": f"my_flow.py:{name}", **keys}, tmp_path)

    return make


def test_user_function_equals_the_flow_it_is(user):
    flow = user("stokeslet", parameters={"strength": 2.0}, rotation=TURN, position=[0.1, 0.2, 0.3])
    turn = rotation_matrix(TURN)
    exact = Stokeslet([0.0, 2.0, 0.0], [4.0, 0.0, 0.0]).rotated(turn).shifted([0.1, 0.2, 0.3])
    x = points(20)
    scale = np.abs(exact.gradient(x)).max()
    assert flow.steady
    assert flow.velocity(x) == pytest.approx(exact.velocity(x), rel=1e-13)
    assert flow.gradient(x) == pytest.approx(exact.gradient(x), abs=1e-11 * scale)
    assert flow.laplacian(x) == pytest.approx(exact.laplacian(x), abs=1e-9 * scale)
    difference = flow.pressure(x) - exact.pressure(x)
    assert difference == pytest.approx(np.full(20, difference[0]), abs=1e-9 * scale)
    report = check_stokesian(flow)
    assert report.divergence < 1e-10
    assert report.vorticity_of_laplacian < 1e-8


def test_user_function_of_time(user):
    flow = user("pulsating")
    assert not flow.steady
    assert flow.velocity([0.0, 2.0, 0.0], np.pi) == pytest.approx([-2.0, 0.0, 0.0])
    assert flow.gradient([0.0, 2.0, 0.0], np.pi)[0, 1] == pytest.approx(-1.0)
    assert not (Shear() + flow).steady


def test_flows_that_are_not_stokesian_are_refused_with_residual_and_point(user):
    with pytest.raises(FlowError, match=r"divergence of the velocity is 1\.73 .* at \(.*vanish"):
        check_stokesian(user("compressible"))
    with pytest.raises(FlowError, match=r"curl of the Laplacian .* is [0-9.]+ .* at \(.*vanish"):
        check_stokesian(user("not_stokesian"))
    with pytest.raises(FlowError, match="curl of the Laplacian"):
        check_stokesian(Shear() + 1e-4 * user("not_stokesian"))
    with pytest.raises(FlowError, match="not finite at"):
        check_stokesian(user("not_finite"))
    third = np.zeros((3, 3, 3, 3))
    third[0, 1, 1, 1] = 6.0
    with pytest.raises(FlowError, match="curl of the Laplacian"):
        check_stokesian(PolynomialFlow(third=third))
    with pytest.raises(FlowError, match="divergence"):
        check_stokesian(PolynomialFlow(gradient=np.eye(3)))


def test_honest_user_flows_pass_the_check_wherever_they_are(user):
    shear = user("shear")
    uniform = UserFlow(lambda x: np.ones_like(x) * 1e3)
    for flow in (shear, uniform, uniform + shear, shear.shifted([0.0, 1e4, 0.0])):
        check_stokesian(flow)
        check_stokesian(flow, radius=75.0)
    check_stokesian(user("stokeslet"), centre=(0.0, 0.0, 0.0), radius=3.0)
    check_stokesian(user("stokeslet", singular_points=[4.0, 0.0, 0.0]), radius=6.0)
    check_stokesian(Stokeslet([1.0, 0.0, 0.0]), radius=2.0)


def test_user_functions_that_cannot_be_used_say_why(user, tmp_path):
    for name, message in (
        ("wrong_shape", "must return a real array of the shape"),
        ("raises", "raised ValueError: no such place"),
    ):
        with pytest.raises(FlowError, match=message):
            user(name).velocity(points())
    with pytest.raises(FlowError, match=r"no function 'shears'; it has shear, stokeslet"):
        user("shears")
    for function, message in (
        ("missing.py:f", "no file"),
        ("my_flow.py", "file.py:function"),
        ("my_flow:shear", "file.py:function"),
    ):
        with pytest.raises(FlowError, match=message):
            build_flow({"type": "user", "function": function}, tmp_path)
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(FlowError, match="raised ZeroDivisionError"):
        build_flow({"type": "user", "function": "broken.py:f"}, tmp_path)


def test_a_users_file_is_executed_once_and_again_when_it_has_changed(tmp_path):
    file = tmp_path / "counted.py"
    text = (
        "from dataclasses import dataclass\nfrom pathlib import Path\n"
        "with open(Path(__file__).with_name('count'), 'a') as stream:\n    stream.write('.')\n"
        "@dataclass\nclass Rate:\n    value: float = 2.0\n"
        "def shear(x):\n    return Rate().value * x[:, [1, 0, 0]] * [1, 0, 0]\n"
        "def other(x):\n    return -shear(x)\n"
    )
    file.write_text(text)
    spec = {"type": "user", "function": "counted.py:shear"}
    one, two = build_flow(spec, tmp_path), build_flow(spec, tmp_path)
    assert one.function is two.function
    assert load_function(f"{tmp_path}/../{tmp_path.name}/counted.py:other").__name__ == "other"
    assert (tmp_path / "count").read_text() == "."
    file.write_text(text.replace("2.0", "3.0"))
    changed = build_flow(spec, tmp_path)
    assert (tmp_path / "count").read_text() == ".."
    assert [flow.velocity([0, 1, 0])[0] for flow in (one, changed)] == [2.0, 3.0]


def test_paths_of_user_functions_are_resolved_in_sums_too(tmp_path):
    spec = {"type": "sum", "terms": [{"type": "user", "function": "a/f.py:u"}, {"type": "shear"}]}
    resolved = resolve_paths(spec, tmp_path)
    assert resolved["terms"][0]["function"] == f"{tmp_path.resolve()}/a/f.py:u"
    assert spec["terms"][0]["function"] == "a/f.py:u"


# -- refusals ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"type": "sheer"}, "unknown flow type 'sheer'; did you mean shear"),
        ({"rate": 1.0}, "needs a key 'type'"),
        ([], "mapping"),
        ({"type": "shear", "rat": 1.0}, "no key 'rat'; did you mean rate"),
        ({"type": "shear", "rate": "fast"}, "rate must be a finite number.*, not 'fast'"),
        ({"type": "shear", "rate": float("nan")}, "finite"),
        ({"type": "shear", "rate": True}, "finite number, not True"),
        ({"type": "linear"}, "needs 'gradient'"),
        ({"type": "linear", "gradient": np.diag([1, 1, 1])}, r"trace 3, .* is \[\[0.0, 0.0"),
        ({"type": "linear", "gradient": [1, 2]}, "3 x 3"),
        ({"type": "linear", "gradient": [[1, 2], [3]]}, "3 x 3"),
        ({"type": "extension", "kind": "odd"}, "one of uniaxial, biaxial, planar"),
        ({"type": "tube_poiseuille", "radius": -1.0}, "positive"),
        ({"type": "paraboloid", "curvature": [1, 2, 3]}, "curvature must hold 2"),
        ({"type": "polynomial"}, "needs 'coefficients'"),
        ({"type": "polynomial", "coefficients": {"u4": {}}}, "of u1, u2 and u3, not 'u4'"),
        ({"type": "polynomial", "coefficients": {"u1": 2.0}}, "map monomials to numbers"),
        ({"type": "polynomial", "coefficients": {"u1": {"x1*x2": 1}}}, "solenoidal.* term x2"),
        ({"type": "polynomial", "coefficients": {"u1": {"x1": 1}}}, "solenoidal"),
        ({"type": "polynomial", "coefficients": {"u1": {"x2^3": 1}}}, "curl of the Laplacian"),
        ({"type": "polynomial", "coefficients": {"u1": {"x2^4": 1}}}, "degree <= 3"),
        ({"type": "polynomial", "gradient": np.eye(3), "coefficients": {}}, "not both"),
        ({"type": "polynomial", "hessian": np.arange(27).reshape(3, 3, 3)}, "symmetric"),
        ({"type": "stokeslet", "position": [0, 0, 0]}, "needs 'strength'"),
        ({"type": "stresslet", "strength": np.eye(3)}, "traceless"),
        ({"type": "sum", "terms": []}, "list of flows"),
        ({"type": "sum", "terms": [{"type": "shear"}, {"type": "no"}]}, "term 2 of the sum"),
        ({"type": "shear", "rotation": [0, 0, 0, 0]}, "zero quaternion"),
        ({"type": "shear", "rotation": -np.eye(3)}, "determinant"),
        ({"type": "shear", "rotation": [1, 2]}, "quaternion of four numbers"),
        ({"type": "shear", "rotation": {"axis": [0, 0, 0], "angle": 1}}, "axis must not be zero"),
        ({"type": "shear", "position": [0, 0]}, "position must hold 3"),
    ],
)
def test_wrong_specifications_say_what_would_be_right(spec, message):
    with pytest.raises(FlowError, match=message):
        build_flow(spec)


def test_numbers_of_single_precision_are_rounded_to_the_nearest_right_ones():
    """As read from a file of float32: accepted, set right and told; further off refused."""
    rng = np.random.default_rng(8)
    matrix = rng.standard_normal((3, 3))
    matrix += matrix.T - 2.0 * np.trace(matrix) / 3.0 * np.eye(3)
    turn = rotation.matrix(rotation.random_quaternions(1, rng)[0])
    second, third = (
        np.tensordot(rng.standard_normal(len(basis)), basis, axes=1)
        for basis in map(stokes_polynomials, (2, 3))
    )
    for spec, key in (
        ({"type": "linear", "gradient": matrix}, "gradient"),
        ({"type": "stresslet", "strength": matrix, "position": [0, 0, 9]}, "strength"),
        ({"type": "shear", "rotation": turn}, "rotation"),
        ({"type": "polynomial", "hessian": second, "third": third}, "third"),
    ):
        rough = {
            k: v.astype(np.float32) if isinstance(v, np.ndarray) else v for k, v in spec.items()
        }
        with pytest.warns(SinglePrecisionWarning, match="single precision"):
            flow = build_flow(rough)
        x, exact = rng.standard_normal((5, 3)), build_flow(spec)
        np.testing.assert_allclose(flow.velocity(x), exact.velocity(x), rtol=0, atol=1e-5)
        assert np.abs(np.einsum("nii->n", flow.gradient(x))).max() < 1e-13
        assert np.abs(flow.vorticity_of_laplacian(x)).max() < 1e-8
        wrong = spec[key].copy()
        wrong[(0,) * wrong.ndim] += 1e-4
        with pytest.raises(FlowError):
            build_flow({**spec, key: wrong})


def test_the_nearest_gradient_that_is_told_works():
    wrong = np.array([[0.1234567, 1.0, 0.0], [0.0, 0.2, 0.0], [0.3, 0.0, -0.33]])
    with pytest.raises(FlowError) as caught:
        build_flow({"type": "linear", "gradient": wrong})
    build_flow({"type": "linear", "gradient": json.loads(str(caught.value).partition(" is ")[2])})


def test_rotations_may_be_given_in_three_ways():
    matrix = rotation_matrix({"axis": [0, 0, 2.0], "angle": np.pi / 2})
    assert matrix @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
    assert rotation_matrix([1.0, 0.0, 0.0, 1.0]) == pytest.approx(matrix)
    assert rotation_matrix(matrix.tolist()) == pytest.approx(matrix)


def test_registry_holds_flows_under_their_own_names():
    for name, flow in REGISTRY.items():
        assert issubclass(flow, Flow)
        assert flow.type_name == name


@pytest.mark.parametrize(
    ("spec", "key"),
    [
        ({"type": "sheer"}, ("type",)),
        ({"type": "shear", "rat": 1.0}, ("rat",)),
        ({"type": "shear", "rate": "fast"}, ("rate",)),
        ({"type": "linear", "gradient": np.eye(3)}, ("gradient",)),
        ({"type": "shear", "rotation": {"axis": [0, 0, 0], "angle": 1}}, ("rotation", "axis")),
        (
            {"type": "polynomial", "coefficients": {"u1": {"x9": 1}}},
            ("coefficients", "u1", "x9"),
        ),
        ({"type": "sum", "terms": [{"type": "shear", "rate": "x"}]}, ("terms", 0, "rate")),
        ({"type": "transformed", "flow": {"type": "no"}}, ("flow", "type")),
        ({"type": "user", "function": "none.py:f"}, ("function",)),
    ],
)
def test_errors_lead_to_the_key_at_fault(spec, key):
    with pytest.raises(FlowError) as caught:
        build_flow(spec)
    assert caught.value.key == key


def test_stokeslets_near_bodies_of_any_size_pass_the_check_as_user_functions_too():
    rng = np.random.default_rng(9)
    for size in 10 ** rng.uniform(0.0, 1.7, 15):
        place = rng.normal(size=3)
        place *= size * rng.uniform(1.5, 5.0) / np.linalg.norm(place)
        stokeslet = Stokeslet(rng.normal(size=3), place)
        assert check_stokesian(stokeslet, radius=2 * size).vorticity_of_laplacian < 1e-8
        check_stokesian(UserFlow(stokeslet.velocity, singular_points=place), radius=2 * size)


def test_a_second_argument_is_the_time_unless_it_is_an_option_of_another_name():
    def optional(x, strength=2.0):
        return strength * np.stack([x[:, 1], 0 * x[:, 0], 0 * x[:, 0]], axis=1)

    def at_time(x, t=0.0):
        return optional(x, t)

    def required(x, when):
        return optional(x, when)

    place = np.array([0.0, 1.0, 0.0])
    assert UserFlow(optional).steady
    assert UserFlow(optional).velocity(place, 5.0)[0] == 2.0
    for function in (at_time, required):
        assert not UserFlow(function).steady
        assert UserFlow(function).velocity(place, 5.0)[0] == 5.0


@pytest.mark.parametrize("keys", [{"radius": 9.0}, {"half_width": 9.0}])
def test_a_pipe_keeps_its_walls_when_it_is_written_down(keys: dict[str, float]) -> None:
    """Turned, moved, scaled or added to, in Python or by keys: the same flow in the same walls."""
    pipe = build_flow(
        {"type": "tube_poiseuille" if "radius" in keys else "plane_poiseuille", **keys}
    )
    turn = rotation.matrix(rotation.from_euler(0.3, 0.7, 1.1))
    by_keys = build_flow({**pipe.spec(), "rotation": turn.tolist(), "position": [0, 0.5, 0]})
    points = np.random.default_rng(0).normal(size=(5, 3))
    for flow in (
        pipe.rotated(turn),
        pipe.shifted([1.0, 2.0, 3.0]).rotated(turn),
        pipe.scaled(2.0).rotated(turn).shifted([1.0, 0.0, 0.0]),
        pipe.plus(build_flow({"type": "shear"})).rotated(turn),
        by_keys.rotated(turn).shifted([0.0, 1.0, 0.0]).scaled(-1.0),
    ):
        again = build_flow(flow.spec())
        np.testing.assert_allclose(again.velocity(points), flow.velocity(points), atol=1e-13)
        assert again.domain
        for edge, same in zip(again.domain, flow.domain, strict=True):
            np.testing.assert_allclose(edge.room(points), same.room(points), atol=1e-13)

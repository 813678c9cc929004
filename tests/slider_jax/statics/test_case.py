"""Static rods in space: shapes of independent solutions, closed forms, and errors of the file."""

import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.errors import InputError, SolverError
from slider_jax.rod.equilibrium import equilibrium, smallest_eigenvalue, solve_equilibrium
from slider_jax.statics.case import load_case

ROD = """[rod]
length = {length}
EI_n = {EI_n}
EI_b = {EI_b}
GJ = {GJ}
{rod}
[load]
{load}
[numerics]
nodes = {nodes}
{more}
"""


def text_of(length=0.368, EI_n=0.038, EI_b=0.038, GJ=0.05, rod="", load="", nodes=51, more=""):
    return ROD.format(
        length=length, EI_n=EI_n, EI_b=EI_b, GJ=GJ, rod=rod, load=load, nodes=nodes, more=more
    )


@pytest.fixture
def case(tmp_path):
    def make(text):
        path = tmp_path / "rod.toml"
        path.write_text(text)
        return load_case(path)

    return make


def tip(found):
    return np.asarray(found.shape.position[-1])


LONG = {"length": 10.0, "EI_n": 100.0, "EI_b": 100.0, "GJ": 100.0}


def helix_of(share):
    """Cantilever that a moment and a force, both along z, wind up (Ibrahimbegovic)."""
    load = f"force = [0, 0, {50.0 * share}]\nmoment = [0, 0, {200.0 * np.pi * share}]"
    return text_of(**LONG, load=load.replace("[0, 0,", "[0.0, 0.0,"))


class TestShapes:
    """Tips of an independent shooting solution and of closed forms, to 0.05 % of the length."""

    def test_end_moment_on_an_isotropic_rod_gives_an_exact_helix(self, case):
        moment = np.array([0.03, 0.01, 0.08])
        x = case(text_of(load=f"moment = {moment.tolist()}"))
        size = np.linalg.norm(moment)
        m, q, ahead = moment / size, size / 0.038, np.array([1.0, 0.0, 0.0])
        psi = q * 0.368
        along = (m @ ahead) * m
        exact = along * 0.368 + np.sin(psi) / q * (ahead - along)
        exact = exact + (1.0 - np.cos(psi)) / q * np.cross(m, ahead)
        found = solve_equilibrium(x.rod, x.loads)
        np.testing.assert_allclose(tip(found), exact, atol=2e-6)
        np.testing.assert_allclose(found.moment, moment, rtol=1e-12)
        assert found.residual < 1e-10

    def test_force_on_an_anisotropic_cantilever(self, case):
        x = case(text_of(EI_b=0.152, load="force = [-0.2, 0.5, 0.5]"))
        found = solve_equilibrium(x.rod, x.loads)
        np.testing.assert_allclose(tip(found), [0.2889885, 0.0568451, 0.1970541], atol=1e-4 * 0.5)
        np.testing.assert_allclose(
            found.moment, [-0.0701045, -0.1839051, 0.1558633], atol=5e-4 * 0.25
        )

    @pytest.mark.parametrize("share, z", [(0.1, -1.096729), (0.2, -0.608497), (0.3, -0.414593)])
    @pytest.mark.slow
    def test_a_rod_wound_up_by_moment_and_force(self, case, share, z):
        """Up to three turns. The bar is 0.05 % of the displacement."""
        x = case(helix_of(share))
        found = solve_equilibrium(x.rod, x.loads)
        assert abs(tip(found)[2] / z - 1.0) < 5e-4

    @pytest.mark.slow
    def test_an_order_of_four(self, case):
        tips = []
        for nodes in (9, 17, 65):
            rod = "linear_density = 2.0\nEA = 10.0"
            load = "force = [-0.2, 0.5, 0.5]\ngravity = [0.0, 3.0, -9.81]"
            x = case(text_of(EI_b=0.152, rod=rod, load=load, nodes=nodes))
            tips.append(tip(equilibrium(x.rod, x.loads, 4)))
        errors = [np.linalg.norm(each - tips[2]) for each in tips[:2]]
        assert 3.7 < np.log2(errors[0] / errors[1]) < 4.3

    @pytest.mark.parametrize(
        "rod, moved",
        [("", [-23.55938, -13.60424, 53.46860]), ("EA = 1e7", [-23.55853, -13.60397, 53.47176])],
    )
    @pytest.mark.slow
    def test_bathes_bend(self, case, rod, moved):
        """A quarter of a quarter circle of radius 100 under a force out of its plane."""
        B, R, angle = 8.3333e5, 100.0, np.pi / 4.0
        text = text_of(
            length=R * angle, EI_n=B, EI_b=B, GJ=B,
            rod=f"initial_curvature = [0.0, 0.0, {1.0 / R}]\n{rod}",
            load="force = [0.0, 0.0, 600.0]",
        )  # fmt: skip
        x = case(text)
        found = solve_equilibrium(x.rod, x.loads)
        start = R * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        np.testing.assert_allclose(tip(found) - start, moved, atol=5e-4 * 60.0)


CHAMBER = """[[chambers]]
span = [{begin}, {end}]
pressure = {pressure}
K_Q = 4.79e-7
distance = 0.01
angles = [{angle}, {far}]
"""


def chambers(*angles, begin=0.05, end=0.25, pressure=60e3, turn=0.0):
    return "".join(
        CHAMBER.format(begin=begin, end=end, pressure=pressure, angle=a, far=a + turn)
        for a in angles
    )


class TestActuators:
    """Closed forms, 0.1 %."""

    @pytest.mark.slow
    def test_each_of_four_chambers_bends_in_its_own_plane(self, case):
        """The moment K_Q p acts about the axis that is normal to the chamber's plane."""
        kappa = 4.79e-7 * 60e3 / 0.038
        turn = kappa * 0.2
        for angle in np.arange(4) * np.pi / 2.0:
            x = case(text_of(more=chambers(angle)))
            found = solve_equilibrium(x.rod, x.loads)
            away = -np.array([0.0, np.cos(angle), np.sin(angle)])
            ahead = 0.05 + np.sin(turn) / kappa + 0.118 * np.cos(turn)
            aside = (1.0 - np.cos(turn)) / kappa + 0.118 * np.sin(turn)
            np.testing.assert_allclose(
                tip(found), ahead * np.array([1.0, 0.0, 0.0]) + aside * away, atol=1e-3 * aside
            )

    @pytest.mark.slow
    def test_chambers_against_each_other_only_stretch(self, case):
        x = case(text_of(rod="EA = 1000.0", more=chambers(0.0, np.pi)))
        found = solve_equilibrium(x.rod, x.loads)
        force = 2.0 * 4.79e-7 * 60e3 / 0.01
        np.testing.assert_allclose(tip(found)[0] - 0.368, 0.2 * force / 1000.0, rtol=1e-3)
        np.testing.assert_allclose(tip(found)[1:], 0.0, atol=1e-9)

    @pytest.mark.slow
    def test_two_helical_chambers_twist(self, case):
        """Twist tau with GJ tau = 2 F d^2 (r + tau)/sqrt(1 + d^2 (r + tau)^2), F the push."""
        turn, d = 8.0, 0.01
        x = case(text_of(more=chambers(0.0, np.pi, turn=turn)))
        found = solve_equilibrium(x.rod, x.loads)
        push, rate = 4.79e-7 * 60e3 / d, turn / 0.2
        twist = 0.0
        for _ in range(100):
            lead = rate + twist
            twist = 2.0 * push * d**2 * lead / np.sqrt(1.0 + (d * lead) ** 2) / 0.05
        frame = np.asarray(found.shape.frame[-1])
        angle = np.arctan2(frame[2, 1], frame[1, 1])
        np.testing.assert_allclose(angle, twist * 0.2, rtol=1e-3)
        np.testing.assert_allclose(tip(found), [0.368, 0.0, 0.0], atol=1e-9)

    @pytest.mark.slow
    def test_a_tendon_bends_towards_itself_and_compresses(self, case):
        place = "start = [0.0, 0.01]\nend = [0.0, 0.01]"
        more = f"[[tendons]]\nspan = [0.0, 0.368]\ntension = 3.0\n{place}"
        x = case(text_of(rod="EA = 1000.0", more=more))
        found = solve_equilibrium(x.rod, x.loads)
        kappa, eps = -3.0 * 0.01 / 0.038, -3.0 / 1000.0
        np.testing.assert_allclose(found.strains[:, 1], kappa, rtol=1e-3)
        np.testing.assert_allclose(found.strains[:, 3], eps, rtol=1e-3)
        assert tip(found)[2] > 0.0

    @pytest.mark.slow
    def test_a_follower_force_keeps_its_angle_to_the_tip(self, case):
        """The moment at the clamp is that of the turned force; the force pushes along the tip."""
        x = case(text_of(load="force = [0.0, 0.4, 0.0]\nfollower = true"))
        found = solve_equilibrium(x.rod, x.loads)
        normal = np.asarray(found.shape.frame[-1])[:, 1]
        np.testing.assert_allclose(found.force, 0.4 * normal, atol=1e-12)
        np.testing.assert_allclose(found.moment, np.cross(tip(found), 0.4 * normal), atol=1e-12)

    def test_weight_in_a_fluid_bends_a_short_rod_as_a_beam(self, case):
        rod = "linear_density = 0.9\nsection_area = 7e-4"
        load = "gravity = [0.0, 0.0, -9.81]\nfluid_density = 1000.0"
        x = case(text_of(length=0.1, rod=rod, load=load))
        found = solve_equilibrium(x.rod, x.loads)
        sag = (0.9 - 0.7) * 9.81 * 0.1**4 / (8.0 * 0.038)
        np.testing.assert_allclose(tip(found)[2], -sag, rtol=1e-3)


END = """[end]
kind = "{kind}"
position = [{x}, 0.0, 0.0]
{more}
"""


def end_of(kind="clamped", x=0.368, more="slides_along = [1.0, 0.0, 0.0]"):
    return END.format(kind=kind, x=x, more=more)


class TestHeldEnd:
    @pytest.mark.parametrize(
        "kind, start, force, moment, near",
        [
            ("clamped", "clamped", 1 / 2, -1 / 12, 1 / 12),
            ("hinged", "clamped", 3 / 8, 0.0, 1 / 8),
            ("hinged", "hinged", 1 / 2, 0.0, 0.0),
        ],
    )
    @pytest.mark.slow
    def test_a_beam_under_its_weight(self, case, kind, start, force, moment, near):
        """Force and moment of both supports of a stiff beam, 0.01 %, in units of w L and w L^2."""
        rod = f'linear_density = 0.1\nstart = "{start}"'
        load = "gravity = [0.0, 0.0, -9.81]"
        x = case(
            text_of(length=0.2, EI_n=10.0, rod=rod, load=load, nodes=11, more=end_of(kind, 0.2))
        )
        found = solve_equilibrium(x.rod, x.loads, x.end)
        w, L = 0.981, 0.2
        np.testing.assert_allclose(found.end_force / (w * L), [0.0, 0.0, force], atol=1e-4)
        np.testing.assert_allclose(found.end_moment / (w * L**2), [0.0, -moment, 0.0], atol=1e-4)
        np.testing.assert_allclose(found.moment / (w * L**2), [0.0, near, 0.0], atol=1e-4)
        assert smallest_eigenvalue(found, x.rod, x.loads, x.end) > 0.0

    @pytest.mark.parametrize("start, moment", [("hinged", 2.0 * np.pi), ("clamped", 8.98682)])
    @pytest.mark.slow
    def test_twist_buckling_from_the_file(self, case, start, moment):
        """Greenhill: below the moment, the rod stays straight; the eigenvalue tends to zero."""
        M = 0.99 * moment * 0.038 / 0.368
        clamped = start == "clamped"
        more = "slides_along = [1.0, 0.0, 0.0]"
        more += f"\nturns = {M * 0.368 / 0.05 / (2.0 * np.pi)}" if clamped else ""
        load = "" if clamped else f"moment = [{M}, 0.0, 0.0]"
        x = case(text_of(rod=f'start = "{start}"', load=load, more=end_of(start, more=more)))
        found = solve_equilibrium(x.rod, x.loads, x.end)
        np.testing.assert_allclose(found.moment, [M, 0.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(tip(found), [0.368, 0.0, 0.0], atol=1e-9)
        assert 0.0 < smallest_eigenvalue(found, x.rod, x.loads, x.end) < 0.03

    @pytest.mark.slow
    def test_a_localised_helix(self, case):
        """A long rod between clamps after 27 turns and a shortening of 3 (shooting solution)."""
        length, B = 100.0, 1.345
        more = end_of(x=97.0, more="turns = 27.0")
        x = case(text_of(length=length, EI_n=B, EI_b=B, GJ=0.789, nodes=151, more=more))
        found = solve_equilibrium(x.rod, x.loads, x.end)
        np.testing.assert_allclose(found.end_moment[0] * length / B, 98.5415, rtol=5e-4)
        np.testing.assert_allclose(found.end_force[0] * length**2 / B, 2900.993, rtol=5e-4)

    def test_a_rigid_turn_of_a_sliding_rod_is_an_error(self, case):
        """Two hinges; the end slides across the rod under a force."""
        x = case(
            text_of(
                rod='start = "hinged"\nEA = 1000.0', load="force = [0.0, 1.0, 0.0]", nodes=3,
                more=end_of("hinged", more="slides_along = [0.0, 1.0, 0.0]"),
            )
        )  # fmt: skip
        with pytest.raises(SolverError, match="as a rigid body.*clamp one end"):
            solve_equilibrium(x.rod, x.loads, x.end)

    @pytest.mark.slow
    def test_an_end_that_cannot_be_reached_is_an_error(self, case):
        """The clamps point away from each other, and the rod is too short to turn back."""
        more = end_of(x=0.3675, more="tangent = [-1.0, 0.0, 0.0]\nnormal = [0.0, 1.0, 0.0]")
        x = case(text_of(nodes=11, more=more))
        with pytest.raises(SolverError, match="move or turn the held end less"):
            solve_equilibrium(x.rod, x.loads, x.end)


GOOD = text_of(load="force = [0.1, 0.0, 0.0]")
BAD = [
    ("length = 0.368", "length = 368.0e3", "rod.length: given 368000.0; allowed 0.0001 to 1000 m"),
    ("length = 0.368", "length = nan", "rod.length: given nan"),
    ("length = 0.368", "", "rod.length: missing; add a value in m"),
    ("EI_n = 0.038", "", "rod.EI_n: given nothing; allowed a number in N m^2, or a column"),
    ("EI_n = 0.038", "EI_n = -1.0", "rod.EI_n: given -1.0; allowed 1e-09 to 1e+09 N m^2"),
    ("EI_n = 0.038", "EIn = 0.038", "rod.EIn: unknown key"),
    ("GJ = 0.05", "GJ = 0.05\nEA = 0.0", "rod.EA: given 0.0; allowed 0.001 to 1e+12 N"),
    ("[load]", "clamp_tangent = [0.0, 0.0, 0.0]\n[load]", "clamp_tangent: given [0.0, 0.0, 0.0]"),
    ("[load]", "clamp_normal = [1.0, 1.0, 0.0]\n[load]", "a vector at a right angle"),
    ("[load]", "initial_curvature = [1.0, 0.0]\n[load]", "rod.initial_curvature.2"),
    ("[load]", 'profile = "none.csv"\n[load]', "none.csv: no such file"),
    ("[load]", 'profile = "../a.csv"\n[load]', "allowed a plain file name"),
    ("[0.1, 0.0, 0.0]", "[0.1, inf, 0.0]", "load.force.1: given inf"),
    ("[0.1, 0.0, 0.0]", "0.1", "load.force"),
    ("[0.1, 0.0, 0.0]", "[0.0, 0.0, 0.0]\ngravity = [0.0, 0.0, -9.81]", "add rod.linear_density"),
    (
        "[0.1, 0.0, 0.0]",
        "[0.0, 0.0, 0.0]\ngravity = [0.0, 0.0, -9810.0]",
        "allowed -100 to 100 m/s^2",
    ),
    ("nodes = 51", "nodes = 1", "numerics.nodes"),
    ("nodes = 51", "nodes = 10.5", "numerics.nodes"),
    ("nodes = 51", "nodes = 51\n" + chambers(0.0, end=0.5), "chambers.0.span: given [0.05, 0.5]"),
    ("nodes = 51", "nodes = 51\n" + chambers(0.0, begin=0.3), "the smaller one first"),
    ("nodes = 51", "nodes = 51\n[[tendons]]\nspan = [0.0, 0.1]", "tendons.0.tension: missing"),
    ("nodes = 51", "nodes = 51\n[[springs]]\nk = 1.0", "springs: unknown key"),
    ("[rod]", "[rod", "not valid TOML"),
    ("[load]", 'start = "hinged"\n[load]', "rod.start: given hinged; allowed clamped"),
    (
        "nodes = 51",
        "nodes = 51\n" + end_of(more=""),
        "load.force: given [0.1, 0.0, 0.0]; allowed zero",
    ),
    ("nodes = 51", "nodes = 51\n" + end_of("welded"), "end.kind"),
    ("nodes = 51", "nodes = 51\n" + end_of("hinged", more="turns = 1.0"), "end.turns: given 1.0"),
    ("nodes = 51", "nodes = 51\n" + end_of(more="turns = inf"), "end.turns: given inf"),
    (
        "nodes = 51",
        "nodes = 51\n" + end_of(more="tangent = [1.0, 0.0, 0.0]"),
        "end.normal: given nothing; allowed a vector, because tangent is given",
    ),
    (
        "nodes = 51",
        "nodes = 51\n" + end_of(more="slides_along = [0.0, 0.0, 0.0]"),
        "end.slides_along: given [0.0, 0.0, 0.0]",
    ),
]


class TestBadInput:
    @pytest.mark.parametrize("old, new, message", BAD)
    def test_each_error_names_the_key_and_what_is_allowed(self, case, old, new, message):
        assert old in GOOD
        with pytest.raises(InputError) as error:
            case(GOOD.replace(old, new, 1))
        assert message in str(error.value)
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize(
        "load, end, message",
        [
            (
                "",
                end_of(more=""),
                "end.position: given [0.368, 0.0, 0.0]; allowed less than 0.368 m",
            ),
            ("force = [0.1, 0.2, 0.0]", end_of(), "allowed a force along end.slides_along"),
            (
                "moment = [0.1, 0.0, 0.0]",
                end_of(),
                "load.moment: given [0.1, 0.0, 0.0]; allowed zero",
            ),
            ("follower = true", end_of(), "load.follower: given True; allowed false"),
            ("", end_of(x=1200.0), "end.position.0: given 1200.0; allowed -1000 to 1000 m"),
        ],
    )
    def test_loads_and_a_held_end(self, case, load, end, message):
        with pytest.raises(InputError) as error:
            case(text_of(load=load, more=end))
        assert message in str(error.value)

    def test_a_place_in_millimetres_is_refused_with_EA_too(self, case):
        message = (
            r"end.position: given \[368.0, .*; allowed less than 2 x rod.length from the start"
        )
        with pytest.raises(InputError, match=message):
            case(text_of(rod="EA = 1000.0", more=end_of(x=368.0, more="")))

    def test_gravity_in_a_fluid_needs_the_area(self, case):
        load = "gravity = [0.0, 0.0, -9.81]\nfluid_density = 1000.0"
        with pytest.raises(InputError, match="add rod.section_area"):
            case(text_of(rod="linear_density = 0.9", load=load))

    @pytest.mark.parametrize(
        "header, row, message",
        [
            ("s_m,EI_n_N_m2", "0.038", "rod.EI_n|EI_n_N_m2: .rod. also has EI_n"),
            ("s_m,GJ_N_m2", "0.05", "also has GJ"),
            ("s_m,EA_N", "-1.0", "line 2, column EA_N: given -1"),
            ("s_m,mass", "1.0", "unknown column mass"),
            ("s_m", "", "no property"),
        ],
    )
    def test_errors_of_a_profile(self, case, tmp_path, header, row, message):
        rows = [f"{s},{row}".rstrip(",") for s in (0.0, 0.368)]
        (tmp_path / "body.csv").write_text("\n".join([header, *rows]) + "\n")
        with pytest.raises(InputError, match=message):
            case(text_of(rod='profile = "body.csv"'))

    def test_a_profile_that_is_too_short_is_refused(self, case, tmp_path):
        (tmp_path / "body.csv").write_text("s_m,EA_N\n0.0,10.0\n0.3,10.0\n")
        with pytest.raises(InputError, match="covers 0 to 0.3 m; allowed 0 to 0.368 m"):
            case(text_of(rod='profile = "body.csv"'))


def test_a_constant_profile_is_the_uniform_rod(case, tmp_path):
    names = "s_m,EI_n_N_m2,EI_b_N_m2,GJ_N_m2,curvature_b_per_m"
    rows = "\n".join(f"{s},0.038,0.038,0.05,1.5" for s in (0.0, 0.1, 0.368))
    (tmp_path / "body.csv").write_text(f"{names}\n{rows}\n")
    file = case('[rod]\nlength = 0.368\nprofile = "body.csv"\n')
    same = case(text_of(rod="initial_curvature = [0.0, 0.0, 1.5]", nodes=101))
    for a, b in zip(
        (file.rod.stiffness, file.rod.initial_curvature),
        (same.rod.stiffness, same.rod.initial_curvature),
        strict=True,
    ):
        np.testing.assert_allclose(a, jnp.asarray(b), rtol=1e-14)

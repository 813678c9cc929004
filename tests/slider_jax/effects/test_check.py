"""An effect file with an error gets one message and adds nothing; all effects pass the check."""

import re

import pytest

from slider_jax.effects import Mounting
from slider_jax.effects.check import PLACES, checked_effects
from slider_jax.effects.library import LIBRARY, load_effects
from slider_jax.errors import InputError
from slider_jax.io.files import LOADED_FILES
from tests.support.own_effects import WALL_FRICTION, restored_library, write_effect


@pytest.fixture(autouse=True)
def library():
    with restored_library() as before:
        yield before


BASE, PARAMETER, FORCE = (
    "WallFriction(ForceDensity)",
    'parameter(0.0, 0.0, 10.0, "N s/m^2", "the range of this test")',
    "-self.c * x.u_tau",
)
MOMENT = "def moment(self, x, memory, dt):\n        return self.c * x.kappa, "
START = PARAMETER.replace(")", ", start=2.0)")
IN_FORCE = r"WallFriction\.force: "
BAD = {
    "syntax": ([("(self, x):", "(self, x)")], "line 19: invalid Python: expected ':'"),
    "import": ([("import jax.numpy", "import no_such")], "cannot be imported: ModuleNotFoundError"),
    "no class": ([("class Wall", "class _Wall"), (BASE, "WallFriction")], "defines no effect"),
    "no title": ([('title = "friction at a wall"', "")], "WallFriction: has no title"),
    "no null": (
        [("= parameter(0.0, 0.0, 10.0, ", "= parameter(")],
        "missing 3 required positional",
    ),
    "no parameter": ([(PARAMETER, "0.0")], "WallFriction: has no parameter with null"),
    "null outside": (
        [("parameter(0.0,", "parameter(-1.0,")],
        "WallFriction.c: given null -1, prior 0 to 10",
    ),
    "default outside": (
        [("_parameter(0.0,", "_parameter(2.0,")],
        "WallFriction.exponent: given default 2, prior 0 to 1",
    ),
    "unknown sensor": (
        [("    c: Scalar", '    sensors = ("thrust", "force")\n    c: Scalar')],
        "WallFriction.sensors: given ('thrust', 'force'); allowed a tuple of ('pressure', 'thrust'",
    ),
    "segment without a comma": (
        [("    c: Scalar", '    segments = ("body")\n    c: Scalar')],
        "WallFriction.segments: given 'body'; allowed a tuple of ('body', 'tail')",
    ),
    "infinite shape tangent": (
        [("(1.0 + x.u_tau**2) **", "jnp.sqrt((5.0 - self.c) * (1.0 + self.exponent)) *")],
        "the derivative with respect to the shape parameter exponent in the middle of the prior",
    ),
    "infinite shape tangent at the null": (
        [(PARAMETER, START), ("-self.c *", "-jnp.sqrt(self.c * (1.0 + self.exponent)) *")],
        "the derivative with respect to the shape parameter exponent at the null",
    ),
    "start outside": (
        [(PARAMETER, START.replace("2.0", "20.0"))],
        "WallFriction.c: given null 0, start 20, prior 0 to 10",
    ),
    "start at the null": (
        [(PARAMETER, PARAMETER.replace(")", ", start=0.0)"))],
        "WallFriction.c: given start 0, equal to the null; allowed is a value at which",
    ),
    "infinite prior": (
        [("10.0,", "float('inf'),")],
        "WallFriction.c: given inf; allowed a finite number",
    ),
    "prior as text": ([("10.0,", "'10',")], "WallFriction.c: given '10'; allowed a finite number"),
    "end of the program": (
        [("import jax.numpy", "raise SystemExit(3)\nimport jax.numpy")],
        "cannot be imported: SystemExit: 3",
    ),
    "missing table": (
        [("import jax.numpy", "open('no_such.csv')\nimport jax.numpy")],
        "cannot be imported: FileNotFoundError",
    ),
    "prior beyond a physical limit": (
        [(PARAMETER, PARAMETER.replace(")", ", physical=(0.0, 5.0))"))],
        "WallFriction.c: given prior 0 to 10, physical limits 0 to 5; the prior range must be",
    ),
    "name of the library": (
        [("class WallFriction", "class HeadDrag")],
        "HeadDrag: the effect 'head_drag' exists in slider_jax; change the class name",
    ),
    "name of the base model": (
        [("class WallFriction", "class NormalDrag")],
        "NormalDrag: the effect 'normal_drag' exists in slider_jax",
    ),
    "no place": (
        [(BASE, "WallFriction(Effect)")],
        "WallFriction: is derived from no base class of a place; allowed is one of Command, Flow",
    ),
    "two places": (
        [
            (BASE, "WallFriction(ForceDensity, BendingMoment)"),
            ("def force", MOMENT + "memory\n\n    def force"),
        ],
        "WallFriction: is derived from BendingMoment and ForceDensity; allowed is one of",
    ),
    "no method": (
        [("def force(", "def push(")],
        "WallFriction: does not define force; an effect of the place ForceDensity defines the",
    ),
    "method of another place": (
        [(BASE, "WallFriction(BendingMoment)")],
        "does not define moment; an effect of the place BendingMoment defines the method moment; "
        "define it, or derive the class from ForceDensity",
    ),
    "NaN value": (
        [(FORCE, FORCE + " / x.height_s")],
        "WallFriction.force: the value at the null, for a robot in motion, is NaN or infinite",
    ),
    "infinite tangent": (
        [(FORCE, "-jnp.sqrt(self.c) * x.u_tau")],
        "WallFriction.force: the derivative with respect to c at the null 0 is NaN or infinite",
    ),
    "infinite tangent at rest": (
        [(FORCE, "-self.c * jnp.sqrt(jnp.abs(x.u_tau))")],
        "the derivative with respect to the motion, for a robot at rest, is NaN or infinite",
    ),
    "NaN at the start": (
        [(PARAMETER, START), (FORCE, FORCE + " / (self.c - 2.0)")],
        "WallFriction.force: the value with c at its start 2 is NaN or infinite",
    ),
    "infinite tangent at the start": (
        [(PARAMETER, START), (FORCE, FORCE + " * jnp.sqrt(jnp.abs(self.c - 2.0))")],
        "WallFriction.force: the derivative with c at its start 2 is NaN or infinite",
    ),
    "no effect at another value": (
        [(FORCE, "-(self.c - 1.0) * x.u_tau")],
        "WallFriction.force: changes the model by up to 0.272 at the null (c = 0)",
    ),
    "wrong shape": (
        [("jnp.zeros_like(x.u_n)", "jnp.zeros(3)")],
        "WallFriction.force: fails on a sample input: TypeError: add got incompatible shapes",
    ),
    "one force": (
        [(", jnp.zeros_like(x.u_n)", ",")],
        "WallFriction.force: returns (array of shape (5,)); allowed (array of shape (5,), array",
    ),
    "scalar memory": (
        [(BASE, "WallFriction(BendingMoment)"), ("def force", MOMENT + "0.0\n\n    def force")],
        "returns a memory of array of shape (); allowed array of shape (5,)",
    ),
    "axial resistance with memory": (
        [
            (BASE, "WallFriction(WakeForce)"),
            ("    c: Scalar", "    resists_axially = True\n    c: Scalar"),
            ("def force(self, x)", "def wake_force(self, x, memory, dt)"),
        ],
        "WallFriction.resists_axially: given True; allowed False, because the thrust",
    ),
    "memory that grows at rest": (
        [
            (BASE, "WallFriction(WakeForce)"),
            (
                "def force(self, x):\n        return ",
                "def wake_force(self, x, memory, dt):\n        F = ",
            ),
            ("jnp.zeros_like(x.u_n)\n", "jnp.zeros_like(x.u_n)\n        return F, memory + dt\n"),
        ],
        "WallFriction.wake_force: changes the model by up to 0.002 at the null (c = 0)",
    ),
    "condition in Python": (
        [(FORCE, f"({FORCE} if self.c > 1.0 else 0.0)")],
        "WallFriction.force: fails on a sample input: TracerBoolConversionError: Attempted",
    ),
    "field without a default": (
        [("    c: Scalar", "    a: Scalar\n    c: Scalar")],
        "fails on a sample input: TypeError: ",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_file_with_an_error_gets_one_message_and_adds_nothing(case, tmp_path, library):
    changes, message = BAD[case]
    path = write_effect(tmp_path / "wall.py", *changes)
    with pytest.raises(
        InputError, match=f"{re.escape(str(path))}: .*{re.escape(message)}"
    ) as error:
        load_effects(path)
    assert "\n" not in str(error.value)
    assert library == LIBRARY and not LOADED_FILES


def test_a_valid_effect_beside_an_invalid_one_is_not_added(tmp_path, library):
    path = write_effect(tmp_path / "wall.py")
    second = WALL_FRICTION.replace("WallFriction", "FloorFriction").replace(FORCE, "x.u_tau")
    path.write_text(WALL_FRICTION + second)
    with pytest.raises(InputError, match=r"FloorFriction\.force: changes the model"):
        load_effects(path)
    assert library == LIBRARY and not LOADED_FILES


def test_two_files_must_not_define_the_same_effect(tmp_path):
    first, second = (write_effect(tmp_path / name) for name in ("wall.py", "floor.py"))
    load_effects(first)
    with pytest.raises(InputError, match=f"'wall_friction' exists in {re.escape(str(first))}"):
        load_effects(second)


def test_a_missing_file_and_a_file_of_another_kind_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        load_effects(tmp_path / "missing.py")
    with pytest.raises(InputError, match="is not a Python file"):
        load_effects(tmp_path / "effects.toml")


def test_a_parameter_with_a_start_needs_no_tangent_at_the_null(tmp_path):
    changes = ((PARAMETER, START), (FORCE, "-jnp.sqrt(self.c) * x.u_tau"))
    assert load_effects(write_effect(tmp_path / "wall.py", *changes)) == ["wall_friction"]


def test_an_infinite_tangent_at_a_null_with_a_start_does_not_concern_other_parameters(tmp_path):
    second = '\n    a: Scalar = parameter(0.0, 0.0, 1.0, "-", "why")\n\n    def force'
    force = "-(jnp.sqrt(self.c) + self.a) * x.u_tau"
    changes = ((PARAMETER, START), ("\n    def force", second), (FORCE, force))
    assert load_effects(write_effect(tmp_path / "wall.py", *changes)) == ["wall_friction"]


def test_an_abstract_base_class_of_two_effects_is_no_effect(tmp_path):
    path = write_effect(tmp_path / "wall.py", ("def force", "def push"), ("WallFriction(", "Wall("))
    method = "    def force(self, x):\n        return self.push(x)\n"
    more = "".join(f"\n\nclass {name}(Wall):\n{method}" for name in ("Left", "Right"))
    path.write_text(path.read_text() + more)
    assert load_effects(path) == ["left", "right"]


# Of the larger places, test_library checks the nulls and the tangents in the default tests.
@pytest.mark.parametrize(
    "place", [p if p is Mounting else pytest.param(p, marks=pytest.mark.slow) for p in PLACES]
)
def test_the_effects_of_the_library_pass_the_check(place):
    kinds = {x.__name__: x for x in LIBRARY.values() if issubclass(x, place)}
    for kind in kinds.values():
        module = type("module", (), {"__name__": kind.__module__, kind.__name__: kind})
        assert checked_effects(module, "library", {}) == [kind]


SLOW_VALVE = '''"""A valve that opens slowly."""

import jax.numpy as jnp

from slider_jax.beam.parameters import Scalar
from slider_jax.effects.base import Flow, parameter


class SlowValve(Flow):
    """dp/dt = (1 - a) q + a z/tau, tau dz/dt = q tau - z. Source: this test."""

    title = "valve that opens slowly"
    states = 1

    a: Scalar = parameter(0.0, 0.0, 1.0, "-", "the range of this test")

    def rate(self, rate, x):
        return (1.0 - self.a) * rate + self.a * x.states[0] / 0.1

    def state_rates(self, rate, x):
        return (rate - x.states[0] / 0.1)[None]
'''


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[None]", "", "state_rates returns the shape (2,); allowed (1, 2)"),
        ("states = 1", "states = 2", "state_rates returns the shape (1, 2); allowed (2, 2)"),
        (
            "def state_rates",
            "def state_rate",
            "slow_valve_again has states, but no method state_rates",
        ),
        ("- x.states[0] / 0.1)", "/ (x.states[0] * 0.0))", "NaN or infinite"),
    ],
)
def test_the_states_of_a_flow_are_checked(tmp_path, old, new, message):
    (tmp_path / "good.py").write_text(SLOW_VALVE)
    load_effects(tmp_path / "good.py")
    text = SLOW_VALVE.replace("SlowValve", "SlowValveAgain").replace(old, new)
    (tmp_path / "bad.py").write_text(text)
    with pytest.raises(InputError) as found:
        load_effects(tmp_path / "bad.py")
    assert message in str(found.value)

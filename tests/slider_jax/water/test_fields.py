"""Velocity fields of the water against closed forms, and invalid files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slider_jax.errors import InputError
from slider_jax.water import VortexStreet, WaterField, karman_speed, read_field
from slider_jax.water.gridded import gridded
from tests.support.helpers import order

A, GAMMA, RATIO = 0.25, 0.04, 0.281
PLACES = np.array([[0.03, 0.02], [-0.11, -0.031], [0.2, 0.3], [-0.37, 0.01]])


def at(field, places, t=0.0):
    """Returns the velocities (n, 2) at `places` (n, 2)."""
    t = jnp.asarray(t, float)
    return np.asarray(jax.vmap(lambda x: field.velocity(x, t))(jnp.asarray(places)))


def arrays_of(field, t, x, y):
    """Returns u and v (t, y, x) of a field."""
    T, Y, X = np.meshgrid(t, y, x, indexing="ij")
    points = jnp.asarray(np.stack([X.ravel(), Y.ravel(), T.ravel()], axis=1))
    U = jax.jit(jax.vmap(lambda p: field.velocity(p[:2], p[2])))(points)
    u, v = np.moveaxis(np.asarray(U).reshape(*T.shape, 2), -1, 0)
    return u, v


def test_a_street_is_the_sum_of_its_vortices():
    """Tolerance 1e-5 of the speed, for 40,000 vortices in each row and small cores."""
    street = VortexStreet(A, GAMMA, 1e-5, (-0.3, 0.05), -0.2, (0.02, 0.01), RATIO)
    t, k = 0.1, np.arange(-20000, 20001)
    expected = np.tile([-0.3, 0.05], (len(PLACES), 1))
    for sign, shift in ((1.0, 0.0), (-1.0, -0.5)):
        dx = PLACES[:, :1] - (0.02 - 0.2 * t + (k + shift) * A)
        dy = PLACES[:, 1:] - (0.01 + sign * 0.5 * RATIO * A)
        factor = sign * GAMMA / (2.0 * np.pi * (dx**2 + dy**2))
        expected += np.stack([(-dy * factor).sum(1), (dx * factor).sum(1)], axis=1)
    np.testing.assert_allclose(at(street, PLACES, t), expected, atol=3e-6)


def test_a_street_moves_itself_and_has_a_deficit_between_its_rows():
    street = VortexStreet(A, GAMMA, 1e-6, ratio=RATIO)
    vortex = np.array([[0.0, 0.5 * RATIO * A]])
    np.testing.assert_allclose(at(street, vortex)[0, 0], karman_speed(A, GAMMA, RATIO), rtol=1e-9)
    x = np.arange(64) / 64 * A
    for y, mean in ((0.0, GAMMA / A), (0.3, 0.0), (-0.3, 0.0)):
        U = at(street, np.stack([x, y + 0.0 * x], axis=1))
        np.testing.assert_allclose(U.mean(0), [mean, 0.0], atol=1e-4)


def test_a_street_with_cores_conserves_volume_and_is_smooth_everywhere():
    street = VortexStreet(A, GAMMA, 0.02)
    slopes = jax.vmap(jax.jacfwd(lambda x: street.velocity(x, jnp.asarray(0.0))))
    found = np.asarray(
        slopes(jnp.asarray(np.vstack([PLACES, [[0.0, 0.5 * RATIO * A]], [[0, 99]]])))
    )
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(found[:, 0, 0], -found[:, 1, 1], atol=1e-12)


@pytest.mark.slow
def test_a_grid_repeats_linear_fields_and_converges_with_third_order():
    x, y, t = np.linspace(-0.5, 0.1, 7), np.linspace(-0.2, 0.4, 5), np.linspace(0.0, 2.0, 4)
    T, Y, X = np.meshgrid(t, y, x, indexing="ij")
    linear = gridded(t, x, y, 0.1 + X - 2.0 * Y + 0.3 * T, 0.2 * X + Y - T)
    point = jnp.array([-0.23, 0.37]), jnp.asarray(1.9)
    expected = [0.1 - 0.23 - 0.74 + 0.57, -0.046 + 0.37 - 1.9]
    np.testing.assert_allclose(linear.velocity(*point), expected, rtol=1e-12)
    slopes = jax.jacfwd(linear.velocity, (0, 1))(*point)
    np.testing.assert_allclose(slopes[0], [[1.0, -2.0], [0.2, 1.0]], rtol=1e-10)
    np.testing.assert_allclose(slopes[1], [0.3, -1.0], rtol=1e-10)

    street, sizes, errors = VortexStreet(A, GAMMA, 0.03, (-0.3, 0.0), -0.25), [20, 40, 80], []
    for n in sizes:
        t, x, y = np.arange(n) / n, np.arange(2 * n) / n - 1.5, np.arange(n) / n - 0.5
        field = gridded(t, x, y, *arrays_of(street, t, x, y), period=1.0)
        errors.append(np.abs(at(field, PLACES, 0.13) - at(street, PLACES, 0.13)).max())
    assert errors[-1] < 1e-3 and order(sizes, errors) < -2.5
    np.testing.assert_allclose(at(field, PLACES, 3.13), at(field, PLACES, 0.13), atol=1e-12)


@pytest.mark.slow
def test_a_grid_with_one_time_is_steady_and_there_is_no_water_outside_the_grid():
    x, y = np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 4)
    U = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 1, 4, 5))
    field = gridded(np.array([7.0]), x, y, *U)
    np.testing.assert_allclose(at(field, PLACES, 0.0), at(field, PLACES, 9.3), rtol=1e-12)
    corners = np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0]])
    np.testing.assert_allclose(at(field, corners), [U[:, 0, 0, 0], U[:, 0, 3, 4], U[:, 0, 0, 4]])
    assert np.isnan(at(field, [[1.01, 0.0], [0.0, -1.2]])).all()
    unsteady = gridded(np.array([0.0, 1.0]), x, y, *np.concatenate([U, U], axis=1))
    assert np.isnan(at(unsteady, PLACES[:1], 1.5)).all()
    assert np.isfinite(at(unsteady, PLACES[:1], 1.0)).all()


@pytest.mark.slow
def test_the_slopes_of_a_grid_are_continuous():
    x = np.linspace(-1.0, 1.0, 9)
    U = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 9, 9, 9))
    field = gridded(x, x, x, *U)
    for line in (x[3], x[5]):
        for axis in range(2):
            slopes = []
            for side in (-1e-9, 1e-9):
                place = jnp.array([0.1, -0.3]).at[axis].set(line + side)
                slopes.append(jax.jacfwd(field.velocity, (0, 1))(place, jnp.asarray(0.2)))
            jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), *slopes)


def test_a_function_for_many_places_is_refused():
    class Wrong(WaterField):
        def velocity(self, place, t):
            return place[0], place[1]

    with pytest.raises(
        ValueError, match=r"Wrong.velocity: .*given tuple; allowed an array of shape \(2,\)"
    ):
        Wrong().at_cells(jnp.zeros((2, 3)), jnp.asarray(0.0), jnp.zeros((2, 2)))


def content(**changes):
    t, x, y = np.arange(3.0), np.linspace(-1.0, 0.1, 5), np.linspace(-0.2, 0.2, 4)
    zero = np.zeros((3, 4, 5))
    return {"t_s": t, "x_m": x, "y_m": y, "u_m_per_s": zero, "v_m_per_s": zero} | changes


GAP = np.zeros((3, 4, 5))
GAP[1, 2, 3] = np.nan
INVALID = {
    "uneven": (dict(x_m=np.array([0, 1, 2, 3, 5.0])), "x_m: given spacings from 1 to 2; .*even"),
    "decreasing": (dict(y_m=np.linspace(1.0, 0.0, 4)), "y_m: given values that do not increase"),
    "NaN in an axis": (dict(t_s=np.array([0, np.nan, 1])), "t_s: given values that do not"),
    "two axes": (dict(y_m=np.zeros((4, 2))), r"y_m: given the shape \(4, 2\); allowed two or more"),
    "one place": (dict(x_m=np.zeros(1)), "x_m: given the shape .* allowed two or more places"),
    "shape": (
        dict(v_m_per_s=np.zeros((3, 5, 4))),
        r"v_m_per_s: given the shape \(3, 5, 4\); allowed \(3, 4, 5\)",
    ),
    "gap": (dict(u_m_per_s=GAP), r"u_m_per_s: given nan at the index \[1, 2, 3\].*fill gaps"),
    "fast": (dict(u_m_per_s=np.full((3, 4, 5), 300.0)), "a speed of 300; allowed at most 3 m/s"),
    "unknown": (dict(p_Pa=np.zeros(1)), "unknown array p_Pa; allowed t_s, x_m"),
    "text": (dict(t_s=np.array(["a", "b", "c"])), "t_s: given the type <U1; allowed numbers"),
    "period": (dict(period_s=np.array(2.0)), "period_s: given 2 s; allowed 3 s"),
    "no period": (dict(period_s=np.array(-1.0)), "period_s: given -1.0; allowed one positive"),
}


@pytest.mark.parametrize("name", INVALID)
def test_an_invalid_file_gives_one_clear_error(name, tmp_path):
    changes, message = INVALID[name]
    path = tmp_path / "field.npz"
    np.savez(path, **content(**changes))
    with pytest.raises(InputError, match=message) as error:
        read_field(path)
    assert str(error.value).startswith(str(path))


def test_a_missing_or_damaged_file_or_array_is_named(tmp_path):
    path = tmp_path / "field.npz"
    with pytest.raises(InputError, match="field.npz: no such file"):
        read_field(path)
    for wrong in (b"", b"not an archive", b"PK\x03\x04 broken"):
        path.write_bytes(wrong)
        with pytest.raises(InputError, match="field.npz: cannot be read as an NPZ file"):
            read_field(path)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(InputError, match="field.npz: cannot be read as an NPZ file"):
        read_field(path)
    few = content()
    del few["v_m_per_s"]
    np.savez(path, **few)
    with pytest.raises(InputError, match="field.npz: no array v_m_per_s; allowed t_s, x_m"):
        read_field(path)
    np.savez(path, **content())
    assert read_field(path).ends["x_m"] == (-1.0, pytest.approx(0.1))

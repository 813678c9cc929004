"""The linear algebra of one Newton iteration: a beam's Jacobian and its structured solve.

Unknowns per node are the forces f = (T, N, M) and the motion v = (V_tau, V_n, phi). A cell ties its
left node j to its right node j + 1 by six equations; three more rows hold at the tail and three at
the head. Rather than eliminate 6 x 6 blocks, every cell is first solved, all cells at once, for its
*scattering* form

    v_left  = S11 f_left + S12 v_right + s1
    f_right = S21 f_left + S22 v_right + s2

which is the response of a short cantilever: forces given at the tail side, motion at the head side,
a problem that is always well posed. Two neighbours join into a longer cantilever by Redheffer's star
product, so the whole body is solved by pairwise joining in log2(cells) levels, and unlike transfer
matrices it does not lose digits on long or soft bodies. The pivots never mix forces with motion, so
every support works without pivoting.

Arrays keep the cell axis last, where it is contiguous: all work is elementwise along it.

Redheffer, R. (1959), Inequalities for a matrix Riccati equation, J. Math. Mech. 8, 349-367.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

class BeamOperator(lx.AbstractLinearOperator):
    """Jacobian of a box-method residual with respect to the nodal unknowns (6, N).

    `left`, `right`: (6 rows, 6 unknowns, cells), the cell equations' derivatives to the cell's two
    nodes. `tail`, `head`: (3 rows, 6 unknowns). Rows are laid out as `Residual`: cells, tail, head.
    """

    left: Float[Array, "6 6 cells"]
    right: Float[Array, "6 6 cells"]
    tail: Float[Array, "3 6"]
    head: Float[Array, "3 6"]

    def mv(self, vector):
        y = vector
        cells = jnp.sum(self.left * y[None, :, :-1] + self.right * y[None, :, 1:], axis=1)
        return cells, self.tail @ y[:, 0], self.head @ y[:, -1]

    def as_matrix(self):
        y = jnp.zeros(self.in_structure().shape, self.left.dtype)
        columns = jax.vmap(lambda e: jnp.concatenate([x.ravel() for x in self.mv(e.reshape(y.shape))]))
        return columns(jnp.eye(y.size)).T

    def transpose(self):
        raise NotImplementedError("to solve with A^T use BeamSolver.transpose")

    def in_structure(self):
        return jax.ShapeDtypeStruct((6, self.left.shape[-1] + 1), self.left.dtype)

    def out_structure(self):
        cells = self.left.shape[-1]
        shapes = ((6, cells), (3,), (3,))
        return tuple(jax.ShapeDtypeStruct(shape, self.left.dtype) for shape in shapes)


def _no_structure(operator):
    del operator
    return False


for _ask in (
    lx.is_symmetric,
    lx.is_diagonal,
    lx.is_tridiagonal,
    lx.has_unit_diagonal,
    lx.is_lower_triangular,
    lx.is_upper_triangular,
    lx.is_positive_semidefinite,
    lx.is_negative_semidefinite,
):
    _ask.register(BeamOperator)(_no_structure)


def _mm(a, b):
    """Product of 3 x 3 by 3 x n blocks, elementwise along the trailing axis."""
    return sum(a[:, k, None] * b[None, k] for k in range(a.shape[1]))


def _mv(a, x):
    return sum(a[:, k] * x[k] for k in range(a.shape[1]))


def _inverse3(a):
    """Inverse of 3 x 3 blocks by cofactors, elementwise along the trailing axis."""
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = a
    r0 = b1 * c2 - b2 * c1
    r1 = b2 * c0 - b0 * c2
    r2 = b0 * c1 - b1 * c0
    scale = 1.0 / (a0 * r0 + a1 * r1 + a2 * r2)
    rows = (
        (r0, a2 * c1 - a1 * c2, a1 * b2 - a2 * b1),
        (r1, a0 * c2 - a2 * c0, a2 * b0 - a0 * b2),
        (r2, a1 * c0 - a0 * c1, a0 * b1 - a1 * b0),
    )
    return jnp.stack([jnp.stack([entry * scale for entry in row]) for row in rows])


def _inverse6(a):
    """Inverse of 6 x 6 blocks by Gauss-Jordan without pivoting, elementwise along the trailing axis.

    Written entry by entry: a blocked form moves three times the memory.
    """
    m = [[a[i, j] for j in range(6)] for i in range(6)]
    for k in range(6):
        pivot = 1.0 / m[k][k]
        m[k] = [entry * pivot for entry in m[k]]
        m[k][k] = pivot
        for i in range(6):
            if i != k:
                factor = m[i][k]
                m[i] = [m[i][j] - factor * m[k][j] for j in range(6)]
                m[i][k] = -factor * pivot
    return jnp.stack([jnp.stack(row) for row in m])


class _Join(eqx.Module):
    """One level of joining: what is needed to find the motion and forces where two pieces meet."""

    E: Array
    A12: Array
    A22: Array
    B11: Array
    B21: Array
    motion: Array
    forces: Array


class _Factors(eqx.Module):
    """A factorised Jacobian: the cells' inverses, the joins, and the two ends."""

    cells: Array
    joins: tuple[_Join, ...]
    body: Array
    tail_f: Array
    tail_v: Array
    tail_solve: Array
    head_f: Array
    head_solve: Array


def _join(A, B):
    """Star product of the scattering matrices (6, 6, k) of neighbours, A towards the tail."""
    A11, A12, A21, A22 = A[:3, :3], A[:3, 3:], A[3:, :3], A[3:, 3:]
    B11, B12, B21, B22 = B[:3, :3], B[:3, 3:], B[3:, :3], B[3:, 3:]
    one = jnp.eye(3, dtype=A.dtype)[:, :, None]
    E = _inverse3(one - _mm(B11, A22))
    motion = _mm(E, jnp.concatenate([_mm(B11, A21), B12], axis=1))
    zero = jnp.zeros_like(A11)
    forces = _mm(A22, motion) + jnp.concatenate([A21, zero], axis=1)
    left = _mm(A12, motion) + jnp.concatenate([A11, zero], axis=1)
    right = _mm(B21, forces) + jnp.concatenate([zero, B22], axis=1)
    return _Join(E, A12, A22, B11, B21, motion, forces), jnp.concatenate([left, right])


def _factorise(operator: BeamOperator) -> _Factors:
    left, right = operator.left, operator.right
    # The unknowns that a cell is solved for are the motion of its left and the forces of its right
    # node; in the rows' order (stretch, turn, moment law, balances) the diagonal is then ~ 1/ds.
    cells = _inverse6(jnp.concatenate([left[:, 3:], right[:, :3]], axis=1))
    S = -_mm(cells, jnp.concatenate([left[:, :3], right[:, 3:]], axis=1))
    joins = []
    while S.shape[-1] > 1:
        pairs = S.shape[-1] // 2
        join, joined = _join(S[..., 0 : 2 * pairs : 2], S[..., 1 : 2 * pairs : 2])
        joins.append(join)
        S = jnp.concatenate([joined, S[..., 2 * pairs :]], axis=-1)
    S = S[..., 0]
    # Tail: G_f f + G_v v = g, solved for f. Head: H_f f + H_v v = h, with f eliminated, for v.
    G_f, G_v = operator.tail[:, :3], operator.tail[:, 3:]
    tail_f = _inverse3(G_f[..., None])[..., 0]
    tail_v = -tail_f @ G_v
    one = jnp.eye(3, dtype=S.dtype)
    tail_solve = _inverse3((one - S[:3, :3] @ tail_v)[..., None])[..., 0]
    H_f, H_v = operator.head[:, :3], operator.head[:, 3:]
    through = S[3:, 3:] + S[3:, :3] @ tail_v @ tail_solve @ S[:3, 3:]
    head_solve = _inverse3((H_f @ through + H_v)[..., None])[..., 0]
    return _Factors(cells, tuple(joins), S, tail_f, tail_v, tail_solve, H_f, head_solve)


def _interleave(even, odd, last):
    both = jnp.stack([even, odd], axis=-1).reshape(3, -1)
    return jnp.concatenate([both, last], axis=-1)


def _solve(factors: _Factors, rhs):
    """Solve A y = rhs; linear in `rhs`, and made of operations that JAX can transpose."""
    r_cells, r_tail, r_head = rhs
    s = _mv(factors.cells, r_cells)
    held = []
    for join in factors.joins:
        pairs = s.shape[-1] // 2
        a, b, rest = s[:, 0 : 2 * pairs : 2], s[:, 1 : 2 * pairs : 2], s[:, 2 * pairs :]
        v = _mv(join.E, _mv(join.B11, a[3:]) + b[:3])
        f = a[3:] + _mv(join.A22, v)
        joined = jnp.concatenate([a[:3] + _mv(join.A12, v), b[3:] + _mv(join.B21, f)])
        held.append((v, f))
        s = jnp.concatenate([joined, rest], axis=-1)
    S, s = factors.body, s[:, 0]
    f_tail0 = factors.tail_f @ r_tail
    v_tail0 = factors.tail_solve @ (S[:3, :3] @ f_tail0 + s[:3])
    f_head0 = S[3:, :3] @ (f_tail0 + factors.tail_v @ v_tail0) + s[3:]
    v_head = factors.head_solve @ (r_head - factors.head_f @ f_head0)
    v_tail = v_tail0 + factors.tail_solve @ (S[:3, 3:] @ v_head)
    f_tail = f_tail0 + factors.tail_v @ v_tail
    f_head = S[3:, :3] @ f_tail + S[3:, 3:] @ v_head + s[3:]
    # Back down: every piece knows the forces at its left end and the motion at its right end.
    f, v = f_tail[:, None], v_head[:, None]
    for join, (v0, f0) in zip(reversed(factors.joins), reversed(held)):
        pairs = v0.shape[-1]
        ends = jnp.concatenate([f[:, :pairs], v[:, :pairs]])
        v_mid = _mv(join.motion, ends) + v0
        f_mid = _mv(join.forces, ends) + f0
        f = _interleave(f[:, :pairs], f_mid, f[:, pairs:])
        v = _interleave(v_mid, v[:, :pairs], v[:, pairs:])
    forces = jnp.concatenate([f, f_head[:, None]], axis=-1)
    motion = jnp.concatenate([v_tail[:, None], v], axis=-1)
    return jnp.concatenate([forces, motion])


class BeamSolver(lx.AbstractLinearSolver):
    """Direct solver for a `BeamOperator`, in O(cells) work and O(log cells) depth."""

    def init(self, operator, options):
        del options
        return _factorise(operator), False

    def compute(self, state, vector, options):
        del options
        factors, transposed = state
        if transposed:
            shape = jax.eval_shape(lambda: _rhs_like(vector))
            (solution,) = jax.linear_transpose(lambda r: _solve(factors, r), shape)(vector)
        else:
            solution = _solve(factors, vector)
        return solution, lx.RESULTS.successful, {}

    def transpose(self, state, options):
        factors, transposed = state
        return (factors, not transposed), options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


def _rhs_like(y):
    return y[:, 1:], y[:3, 0], y[:3, 0]

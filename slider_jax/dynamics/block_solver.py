"""The Jacobian of a stage as a linear operator, and its structured direct solver.

The unknowns per node are the forces f and the motion v, with k components each. In the plane, k is
3, f = (T, N, M) and v = (V_tau, V_n, phi). In three dimensions, k is 6. 2 k equations connect the
left node j of a cell to the right node j + 1. k boundary conditions hold at the tail and k at the
head. The solver first transforms all cells to the *scattering* form

    v_left  = S11 f_left + S12 v_right + s1
    f_right = S21 f_left + S22 v_right + s2

with matrices S and vectors s. A cell in this form is a short cantilever with given forces at the
tail side and given motion at the head side. This problem is always well posed. Redheffer's star
product joins two neighbours into a longer cantilever. Pairwise joining solves the whole body in
log2(cells) levels. Unlike transfer matrices, the method loses no digits on long or soft bodies. No
pivoting is required, because the pivots never mix forces and motion. The cells are along the last
axis, and all operations are elementwise along this contiguous axis.

On a CPU with a C++ compiler, the functions of `block_kernel` do the same in less time. They pass
along the body from the tail to the head instead of joining pairs.

Source: Redheffer, R. (1959), Inequalities for a matrix Riccati equation, J. Math. Mech. 8, 349-367.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from slider_jax.dynamics import block_kernel


class Update(eqx.Module):
    """The sum of the products column x row, as a part of a `BeamOperator`.

    It adds sum_j columns_j (rows_j . y) to the cell equations.
    """

    columns: Float[Array, "n 2k cells"]
    rows: Float[Array, "n 2k nodes"]

    def weights(self, y) -> Float[Array, " n"]:
        """Returns rows_j . y."""
        return jnp.sum(self.rows * y, axis=(1, 2))


class BeamOperator(lx.AbstractLinearOperator):
    """Jacobian of the box-method residual with respect to the nodal unknowns (2 k, N).

    `left`, `right` (2 k rows, 2 k unknowns, cells): derivatives of the cell equations with respect
    to the two nodes of the cell. `tail`, `head` (k rows, 2 k unknowns): derivatives of the boundary
    conditions. Rows are in the order of `residual`: cells, tail, head. `update` is the part that
    couples distant cells.
    """

    left: Float[Array, "2k 2k cells"]
    right: Float[Array, "2k 2k cells"]
    tail: Float[Array, "k 2k"]
    head: Float[Array, "k 2k"]
    update: Update | None = None

    def mv(self, y):
        cells = jnp.sum(self.left * y[None, :, :-1] + self.right * y[None, :, 1:], axis=1)
        if self.update is not None:
            cells = cells + jnp.tensordot(self.update.weights(y), self.update.columns, 1)
        return cells, self.tail @ y[:, 0], self.head @ y[:, -1]

    def as_matrix(self):
        y = jnp.zeros(self.in_structure().shape, self.left.dtype)
        columns = jax.vmap(
            lambda e: jnp.concatenate([x.ravel() for x in self.mv(e.reshape(y.shape))])
        )
        return columns(jnp.eye(y.size)).T

    def transpose(self):
        raise NotImplementedError("BeamOperator.transpose does not exist; use BeamSolver.transpose")

    def in_structure(self):
        rows, _, cells = self.left.shape
        return jax.ShapeDtypeStruct((rows, cells + 1), self.left.dtype)

    def out_structure(self):
        rows, _, cells = self.left.shape
        shapes = ((rows, cells), (rows // 2,), (rows // 2,))
        return tuple(jax.ShapeDtypeStruct(shape, self.left.dtype) for shape in shapes)


# lineax queries these properties of every operator on construction.
for _query in (
    lx.is_symmetric,
    lx.is_diagonal,
    lx.is_tridiagonal,
    lx.has_unit_diagonal,
    lx.is_lower_triangular,
    lx.is_upper_triangular,
    lx.is_positive_semidefinite,
    lx.is_negative_semidefinite,
):
    _query.register(BeamOperator)(lambda operator: False)


# With `_keep`, the compiler computes a value only once, even if several expressions use the value.
_keep = jax.lax.optimization_barrier


def _mm(a, b):
    """Returns the product of m x k and k x n blocks, elementwise along the last axis."""
    return sum(a[:, k, None] * b[None, k] for k in range(a.shape[1]))


def _mv(a, x):
    return sum(a[:, k] * x[k] for k in range(a.shape[1]))


def _inverse_of_3(a):
    """Returns the inverse of 3 x 3 blocks by cofactors, elementwise along the last axis."""
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


def _inverse(a):
    """Inverts square blocks by block Gauss-Jordan elimination, elementwise along the last axis.

    The diagonal blocks of 3 x 3 are eliminated in order, without row exchange, so each must be
    invertible when its turn comes. The size is 3, 6 or 12. Each pass eliminates the first three
    rows and columns and moves them to the end, so the last pass restores their order.
    """
    if a.shape[0] == 3:
        return _inverse_of_3(a)
    for _ in range(a.shape[0] // 3):
        pivot = _keep(_inverse_of_3(a[:3, :3]))
        row, column = _keep(_mm(pivot, a[:3, 3:])), a[3:, :3]
        rest = jnp.concatenate([a[3:, 3:] - _mm(column, row), -_mm(column, pivot)], axis=1)
        a = _keep(jnp.concatenate([rest, jnp.concatenate([row, pivot], axis=1)]))
    return a


def _halving_order(cells: int) -> list[int]:
    """Returns an order of the cells in which each level joins two contiguous slices of k pieces.

    A piece is one cell or several joined cells. In this order, pieces i and i + k are neighbours on
    the body for all i < k. A level joins these pairs. With 2 k + 1 pieces, the last is not joined.
    """
    if cells == 1:
        return [0]
    pairs, odd = divmod(cells, 2)
    upper = _halving_order(pairs + odd)[:pairs]
    return [2 * i for i in upper] + [2 * i + 1 for i in upper] + [cells - 1] * odd


class _Join(eqx.Module):
    """Matrices of one level of joins; they give motion and forces where two pieces meet."""

    E: Array
    A12: Array
    A22: Array
    B11: Array
    B21: Array
    motion: Array
    forces: Array


class _Factors(eqx.Module):
    """A factorised Jacobian: inverses of the cells' blocks, joins, and boundary conditions."""

    cells: Array
    joins: tuple[_Join, ...]
    body: Array
    tail_f: Array
    tail_v: Array
    tail_solve: Array
    head_f: Array
    head_solve: Array


def _join(A, B):
    """Joins neighbours A (tail side) and B by the star product of scattering matrices."""
    k = A.shape[0] // 2
    A11, A12, A21, A22 = A[:k, :k], A[:k, k:], A[k:, :k], A[k:, k:]
    B11, B12, B21, B22 = B[:k, :k], B[:k, k:], B[k:, :k], B[k:, k:]
    one = jnp.eye(k, dtype=A.dtype)[:, :, None]
    E = _keep(_inverse(_keep(one - _mm(B11, A22))))
    motion = _keep(_mm(E, _keep(jnp.concatenate([_mm(B11, A21), B12], axis=1))))
    zero = jnp.zeros_like(A11)
    forces = _keep(_mm(A22, motion) + jnp.concatenate([A21, zero], axis=1))
    left = _mm(A12, motion) + jnp.concatenate([A11, zero], axis=1)
    right = _mm(B21, forces) + jnp.concatenate([zero, B22], axis=1)
    return _Join(E, A12, A22, B11, B21, motion, forces), jnp.concatenate([left, right])


def _factorise(operator: BeamOperator) -> _Factors:
    left, right = operator.left, operator.right
    k = operator.tail.shape[0]
    # Each cell is solved for the motion of its left node and the forces of its right node. The rows
    # are in the order stretch, turn, moment law, balances, so diagonal entries are of order 1/ds.
    cells = _inverse(jnp.concatenate([left[:, k:], right[:, :k]], axis=1))
    S = _keep(-_mm(cells, jnp.concatenate([left[:, :k], right[:, k:]], axis=1)))
    S = S[..., np.array(_halving_order(S.shape[-1]))]
    joins = []
    while S.shape[-1] > 1:
        pairs = S.shape[-1] // 2
        join, joined = _join(S[..., :pairs], S[..., pairs : 2 * pairs])
        joins.append(join)
        S = _keep(jnp.concatenate([joined, S[..., 2 * pairs :]], axis=-1))
    S = S[..., 0]
    # The tail's conditions G_f f + G_v v = g give f at the tail. After f is eliminated, the head's
    # conditions H_f f + H_v v = h give v at the head.
    G_f, G_v = operator.tail[:, :k], operator.tail[:, k:]
    tail_f = _inverse(G_f[..., None])[..., 0]
    tail_v = -tail_f @ G_v
    one = jnp.eye(k, dtype=S.dtype)
    tail_solve = _inverse((one - S[:k, :k] @ tail_v)[..., None])[..., 0]
    H_f, H_v = operator.head[:, :k], operator.head[:, k:]
    through = S[k:, k:] + S[k:, :k] @ tail_v @ tail_solve @ S[:k, k:]
    head_solve = _inverse((H_f @ through + H_v)[..., None])[..., 0]
    return _Factors(cells, tuple(joins), S, tail_f, tail_v, tail_solve, H_f, head_solve)


def _solve(factors: _Factors, rhs):
    """Returns the solution y of A y = rhs with the factorised A; JAX can transpose the function."""
    r_cells, r_tail, r_head = rhs
    k = r_tail.shape[0]
    order = np.array(_halving_order(r_cells.shape[-1]))
    s = _keep(_keep(_mv(factors.cells, r_cells))[:, order])
    meetings = []
    for join in factors.joins:
        pairs = join.E.shape[-1]
        a, b, rest = s[:, :pairs], s[:, pairs : 2 * pairs], s[:, 2 * pairs :]
        v = _keep(_mv(join.E, _mv(join.B11, a[k:]) + b[:k]))
        f = _keep(a[k:] + _mv(join.A22, v))
        meetings.append((v, f))
        joined = jnp.concatenate([a[:k] + _mv(join.A12, v), b[k:] + _mv(join.B21, f)])
        s = _keep(jnp.concatenate([joined, rest], axis=-1))
    S, s = factors.body, s[:, 0]
    f_tail0 = factors.tail_f @ r_tail
    v_tail0 = factors.tail_solve @ (S[:k, :k] @ f_tail0 + s[:k])
    f_head0 = S[k:, :k] @ (f_tail0 + factors.tail_v @ v_tail0) + s[k:]
    v_head = factors.head_solve @ (r_head - factors.head_f @ f_head0)
    v_tail = v_tail0 + factors.tail_solve @ (S[:k, k:] @ v_head)
    f_tail = f_tail0 + factors.tail_v @ v_tail
    f_head = S[k:, :k] @ f_tail + S[k:, k:] @ v_head + s[k:]
    # The forces at the left end and the motion at the right end of each piece are now known.
    ends = jnp.concatenate([f_tail, v_head])[:, None]
    for join, (v0, f0) in zip(reversed(factors.joins), reversed(meetings), strict=True):
        pairs = v0.shape[-1]
        outer = ends[:, :pairs]
        v_mid = _mv(join.motion, outer) + v0
        f_mid = _mv(join.forces, outer) + f0
        left = jnp.concatenate([outer[:k], v_mid])
        right = jnp.concatenate([f_mid, outer[k:]])
        ends = _keep(jnp.concatenate([left, right, ends[:, pairs:]], axis=-1))
    ends = ends[:, np.argsort(order)]
    forces = jnp.concatenate([ends[:k], f_head[:, None]], axis=-1)
    motion = jnp.concatenate([v_tail[:, None], ends[k:]], axis=-1)
    return jnp.concatenate([forces, motion])


class _Compiled(eqx.Module):
    """Factors of `block_kernel`, and the blocks of the operator if the solve has derivatives."""

    factors: Array
    blocks: BeamOperator | None


def _factorise_compiled(operator: BeamOperator, differentiable: bool) -> _Compiled:
    blocks = replace(operator, update=None)
    parts = jax.lax.stop_gradient((blocks.left, blocks.right, blocks.tail, blocks.head))
    return _Compiled(block_kernel.factorise(*parts), blocks if differentiable else None)


def _solve_compiled(factors: _Compiled, rhs):
    """Returns the solution; its derivatives follow from the operator, not from its factors."""
    blocks = factors.blocks
    if blocks is None:
        return block_kernel.solve(factors.factors, rhs)
    k = rhs[1].shape[0]

    def with_ends_first(parts):
        cells, tail, head = parts
        return jnp.concatenate([jnp.concatenate([tail, head])[:, None], cells], axis=1)

    def as_parts(x):
        return x[:, 1:], x[:k, 0], x[k:, 0]

    # JAX requires that each array of the right side depends on the tangent; one array does.
    return jax.lax.custom_linear_solve(
        lambda y: with_ends_first(blocks.mv(y)),
        with_ends_first(rhs),
        lambda _, x: block_kernel.solve(factors.factors, as_parts(x)),
        lambda _, y: with_ends_first(block_kernel.solve_transposed(factors.factors, y)),
    )


class _Updated(eqx.Module):
    """A factorised Jacobian with an `Update`, by the Sherman-Morrison-Woodbury formula.

    `solved` are the solutions for the columns of the update. `inverse` is (1 + rows . solved)^-1.
    """

    blocks: _Factors | _Compiled
    update: Update
    solved: Array
    inverse: Array


def _factorise_all(operator: BeamOperator, compiled: bool, differentiable: bool):
    """Returns the `_Factors`, `_Compiled` or `_Updated` of an operator."""
    update = operator.update
    blocks = _factorise_compiled(operator, differentiable) if compiled else _factorise(operator)
    if update is None:
        return blocks
    none = jnp.zeros(operator.tail.shape[0], operator.left.dtype)
    solved = jax.vmap(lambda column: _solve_all(blocks, (column, none, none)))(update.columns)
    products = jax.vmap(update.weights, out_axes=1)(solved)
    inverse = jnp.linalg.inv(jnp.eye(len(solved), dtype=none.dtype) + products)
    return _Updated(blocks, update, solved, inverse)


def _solve_all(factors: _Factors | _Compiled | _Updated, rhs):
    if isinstance(factors, _Compiled):
        return _solve_compiled(factors, rhs)
    if isinstance(factors, _Factors):
        return _solve(factors, rhs)
    y = _solve_all(factors.blocks, rhs)
    return y - jnp.tensordot(factors.inverse @ factors.update.weights(y), factors.solved, 1)


class BeamSolver(lx.AbstractLinearSolver):
    """Direct solver for a `BeamOperator`; the number of operations is proportional to the cells.

    `init` factorises the operator. `compute` solves with these factors and may be called
    repeatedly. Reverse mode transposes `compute`, so `BeamOperator` needs no transpose.

    `compiled` chooses between `block_kernel` and the functions in JAX. None chooses the former if
    it is available.
    Without `differentiable`, the state is smaller, and `compute` may have no derivatives.
    """

    compiled: bool | None = None
    differentiable: bool = True

    def init(self, operator, options):
        double, compiled = operator.left.dtype == jnp.float64, self.compiled
        if compiled is None:
            compiled = double and block_kernel.is_used()
        if compiled and not (double and block_kernel.is_used()):
            raise ValueError(
                f"BeamSolver(compiled=True): given {operator.left.dtype} on "
                f"{jax.default_backend()}; allowed float64 on a CPU with a C++ compiler"
            )
        return _factorise_all(operator, compiled, self.differentiable), False

    def compute(self, state, vector, options):
        factors, transposed = state
        if transposed:
            k = vector.shape[0] // 2
            shape = jax.eval_shape(lambda y: (y[:, 1:], y[:k, 0], y[:k, 0]), vector)
            (solution,) = jax.linear_transpose(lambda r: _solve_all(factors, r), shape)(vector)
        else:
            solution = _solve_all(factors, vector)
        return solution, lx.RESULTS.successful, {}

    def correct(self, factors, rhs, scale, y, sizes):
        """Returns y - x, where x solves for `rhs`, and the `sizes` (2,) of the last two changes.

        The size of a change is the largest |x| / max(scale, |y|). `factors` are the first part of a
        state. Unless `differentiable`, there are no derivatives.
        """
        if isinstance(factors, _Compiled) and not self.differentiable:
            return block_kernel.correct(factors.factors, rhs, scale, y, sizes)
        change = _solve_all(factors, rhs)
        size = jnp.max(jnp.abs(change / jnp.maximum(scale, jnp.abs(y))))
        return y - change, jnp.stack([sizes[1], size])

    def transpose(self, state, options):
        factors, transposed = state
        return (factors, not transposed), options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True

// Factorises and solves the block systems of `block_solver.py`, as custom calls of XLA.
//
// Each node has K forces f and K components of motion v; 2K equations connect the nodes of a cell:
//
//     L_f f_c + L_v v_c + R_f f_{c+1} + R_v v_{c+1} = r_c
//
// The part of the body behind node c acts like f_c = P_c v_c + p_c. From the tail to the head, each
// cell gives its left motion and its right forces from the right motion:
//
//     (v_c, f_{c+1}) = B r_c + C p_c + D v_{c+1},    B = [L_v + L_f P_c, R_f]^-1,
//     C = -B L_f,    D = -B R_v,    P_{c+1} = D_f,    p_{c+1} = (B r_c + C p_c)_f
//
// The suffixes v and f are the upper and the lower K rows. The conditions at the head give the motion
// there, and the way back gives all other unknowns. The inverses of cells need no row exchange: a body
// with given forces behind and given motion ahead always has a solution, and the rows are in the order
// stretch, turn, moment law, balances, so diagonal entries are of order 1/ds. The same holds for E below.
//
// The conditions are G_f f + G_v v = g at the tail and H_f f + H_v v = h at the head. Both are solved
// with row exchange: tail_f = G_f^-1, P_0 = -tail_f G_v, head_v = (H_f P + H_v)^-1. The factors of a
// robot are B, C and D (8 K^2 numbers per cell), tail_f, P_0, head_v and H_f (K^2 numbers each).
//
// The robots of a batch are factorised LANES at a time, with one robot per lane of a vector. A single
// robot is factorised in another order of operations, with one cell per lane where this is possible.
// The values of a robot do not depend on those of other robots; only their rounding depends on whether
// the robot is in a group of LANES.

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>
#include <vector>

#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace {

// The number of doubles in a vector. Vectors of eight are slow without AVX-512: each takes two or more
// registers, and there are fewer registers.
#ifdef __AVX512F__
constexpr int LANES = 8;
#else
constexpr int LANES = 4;
#endif
typedef double Vec __attribute__((vector_size(8 * LANES)));
typedef int64_t Lanes __attribute__((vector_size(8 * LANES)));
typedef double Unaligned __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

template <size_t... LANE>
constexpr Lanes count_lanes(std::index_sequence<LANE...>) {
  return Lanes{LANE...};
}
constexpr Lanes NUMBERS = count_lanes(std::make_index_sequence<LANES>());

inline Vec load(const double* x) { return *reinterpret_cast<const Unaligned*>(x); }
inline void store(double* x, Vec v) { *reinterpret_cast<Unaligned*>(x) = v; }

constexpr int64_t padded(int64_t cells, int64_t multiple = LANES) {
  return (cells + multiple - 1) / multiple * multiple;
}

// The same for all processors, so that Python need not know LANES.
template <int K>
constexpr int64_t factor_size(int64_t cells) {
  return 8 * K * K * padded(cells, 8) + 4 * K * K;
}

// The parts of the factors. Rows: entry (i, j) of cell c of a matrix is at (i * columns + j) * stride
// + c. The matrices of the two passes along the body are together for each cell.
template <int K, class T>
struct Factors {
  int64_t stride;
  T *B, *C_v, *D_f, *passes, *tail_f, *P, *head_v, *H_f;

  Factors(T* x, int64_t cells)
      : stride(padded(cells)),
        B(x),
        C_v(B + 4 * K * K * stride),
        D_f(C_v + K * K * stride),
        passes(D_f + K * K * stride),
        tail_f(passes + 2 * K * K * stride),
        P(tail_f + K * K),
        head_v(P + K * K),
        H_f(head_v + K * K) {}

  T* C_f(int64_t c) const { return passes + c * 2 * K * K; }
  T* D_v(int64_t c) const { return C_f(c) + K * K; }
};

// Inverts a K x K matrix with partial pivoting.
template <int K>
void invert(double (&a)[K][K], double* inverse) {
  double b[K][K] = {};
  for (int i = 0; i < K; i++) b[i][i] = 1.0;
  for (int p = 0; p < K; p++) {
    int best = p;
    for (int i = p + 1; i < K; i++)
      if (std::abs(a[i][p]) > std::abs(a[best][p])) best = i;
    for (int j = 0; j < K; j++) {
      std::swap(a[p][j], a[best][j]);
      std::swap(b[p][j], b[best][j]);
    }
    const double scale = 1.0 / a[p][p];
    for (int j = 0; j < K; j++) {
      a[p][j] *= scale;
      b[p][j] *= scale;
    }
    for (int i = 0; i < K; i++) {
      if (i == p) continue;
      const double factor = a[i][p];
      for (int j = 0; j < K; j++) {
        a[i][j] -= factor * a[p][j];
        b[i][j] -= factor * b[p][j];
      }
    }
  }
  std::memcpy(inverse, b, sizeof(b));
}

// Inverts a 3 x 3 matrix by cofactors.
template <class X>
inline void invert_3(const X (&a)[3][3], X (&b)[3][3]) {
  for (int i = 0; i < 3; i++) {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    for (int l = 0; l < 3; l++) {
      const int m = (l + 1) % 3, n = (l + 2) % 3;
      b[l][i] = a[j][m] * a[k][n] - a[j][n] * a[k][m];
    }
  }
  const X scale = 1.0 / (a[0][0] * b[0][0] + a[0][1] * b[1][0] + a[0][2] * b[2][0]);
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) b[i][j] *= scale;
}

// Inverts a matrix by Gauss-Jordan elimination with blocks of 3 x 3, without row exchange. X is a
// number, or a vector with one number of each of several robots or cells. The function is not inlined,
// because g++ made slower code of it inside long functions.
template <int N, class X>
[[gnu::noinline]] void invert_in_place(X (&a)[N][N]) {
#pragma GCC unroll 1
  for (int p = 0; p < N; p += 3) {
    X block[3][3], pivot[3][3], rows[3][N];
#pragma GCC unroll 3
    for (int i = 0; i < 3; i++)
#pragma GCC unroll 3
      for (int j = 0; j < 3; j++) block[i][j] = a[p + i][p + j];
    invert_3(block, pivot);
#pragma GCC unroll 3
    for (int i = 0; i < 3; i++)
#pragma GCC unroll 3
      for (int j = 0; j < 3; j++) a[p + i][p + j] = i == j ? X{} + 1.0 : X{};
#pragma GCC unroll 3
    for (int i = 0; i < 3; i++)
#pragma GCC unroll 16
      for (int j = 0; j < N; j++)
        rows[i][j] = pivot[i][0] * a[p][j] + pivot[i][1] * a[p + 1][j] + pivot[i][2] * a[p + 2][j];
#pragma GCC unroll 1
    for (int i = 0; i < N; i++) {
      const X x = a[i][p], y = a[i][p + 1], z = a[i][p + 2];
      a[i][p] = a[i][p + 1] = a[i][p + 2] = X{};
#pragma GCC unroll 16
      for (int j = 0; j < N; j++) a[i][j] -= x * rows[0][j] + y * rows[1][j] + z * rows[2][j];
    }
#pragma GCC unroll 3
    for (int i = 0; i < 3; i++)
#pragma GCC unroll 16
      for (int j = 0; j < N; j++) a[p + i][j] = rows[i][j];
  }
}

// c = a b, and c += a b.
template <bool ADD, int M, int N, int L>
[[gnu::noinline]] void product(const Vec (&a)[M][N], const Vec (&b)[N][L], Vec (&c)[M][L]) {
#pragma GCC unroll 1
  for (int i = 0; i < M; i++) {
    Vec sum[L];
#pragma GCC unroll 16
    for (int j = 0; j < L; j++) sum[j] = ADD ? c[i][j] + a[i][0] * b[0][j] : a[i][0] * b[0][j];
#pragma GCC unroll 1
    for (int k = 1; k < N; k++) {
#pragma GCC unroll 16
      for (int j = 0; j < L; j++) sum[j] += a[i][k] * b[k][j];
    }
#pragma GCC unroll 16
    for (int j = 0; j < L; j++) c[i][j] = sum[j];
  }
}
template <int M, int N, int L>
void multiply(const Vec (&a)[M][N], const Vec (&b)[N][L], Vec (&c)[M][L]) {
  product<false>(a, b, c);
}
template <int M, int N, int L>
void multiply_add(const Vec (&a)[M][N], const Vec (&b)[N][L], Vec (&c)[M][L]) {
  product<true>(a, b, c);
}

// c = a b for small matrices of one robot, inlined.
template <int K>
inline void multiply_small(const double (&a)[K][K], const double (&b)[K][K], double (&c)[K][K]) {
#pragma GCC unroll 8
  for (int i = 0; i < K; i++)
#pragma GCC unroll 8
    for (int j = 0; j < K; j++) {
      double sum = a[i][0] * b[0][j];
#pragma GCC unroll 8
      for (int k = 1; k < K; k++) sum += a[i][k] * b[k][j];
      c[i][j] = sum;
    }
}

// Memory that grows, and stays for the next call of its thread.
template <class X>
X* work_of(size_t size) {
  static thread_local std::vector<double> work;
  const size_t spare = sizeof(Vec) / sizeof(double);
  if (work.size() < size * (sizeof(X) / 8) + spare) work.resize(size * (sizeof(X) / 8) + spare);
  const auto at = reinterpret_cast<uintptr_t>(work.data());
  return reinterpret_cast<X*>((at + sizeof(Vec) - 1) / sizeof(Vec) * sizeof(Vec));
}

// The first or the second of two vectors after they exchanged the halves of their blocks of
// 2 * HALF lanes.
template <int HALF, bool SECOND, size_t... LANE>
inline Vec exchanged(Vec x, Vec y, std::index_sequence<LANE...>) {
#if defined(__clang__) || __GNUC__ >= 12
  return __builtin_shufflevector(x, y,
                                 (SECOND ? (LANE & HALF ? LANES + LANE : LANE + HALF)
                                         : (LANE & HALF ? LANES + LANE - HALF : LANE))...);
#else
  if (SECOND) return Vec{(LANE & HALF ? y[LANE] : x[(LANE + HALF) % LANES])...};
  return Vec{(LANE & HALF ? y[LANE - (LANE & HALF)] : x[LANE])...};
#endif
}

template <int HALF>
inline void exchange(Vec (&a)[LANES]) {
  constexpr auto all = std::make_index_sequence<LANES>();
#pragma GCC unroll 8
  for (int i = 0; i < LANES; i++) {
    if (i & HALF) continue;
    const Vec x = a[i], y = a[i + HALF];
    a[i] = exchanged<HALF, false>(x, y, all);
    a[i + HALF] = exchanged<HALF, true>(x, y, all);
  }
}

// Exchanges rows and columns: lane j of vector i becomes lane i of vector j.
inline void transpose(Vec (&a)[LANES]) {
  if constexpr (LANES == 8) exchange<4>(a);
  exchange<2>(a);
  exchange<1>(a);
}

inline double* lanes(Vec& x) {
  return reinterpret_cast<double*>(&x);
}

// Replaces the matrices L and R of a cell by B, and the halves of C and D in the order C_v, D_f, C_f,
// D_v. P of the left node becomes P of the right node.
template <int K>
[[gnu::noinline]] void factorise_cell(Vec* entries, Vec (&P)[K][K]) {
  constexpr int N = 2 * K;
  Vec A[N][N], L_f[N][K], R_v[N][K], C[N][K], D[N][K];
  for (int i = 0; i < N; i++)
    for (int k = 0; k < K; k++) {
      const Vec *left = entries + i * N, *right = left + N * N;
      L_f[i][k] = -left[k];
      C[i][k] = -left[K + k];
      A[i][K + k] = right[k];
      R_v[i][k] = -right[K + k];
    }
  multiply_add(L_f, P, C);
  for (int i = 0; i < N; i++)
    for (int k = 0; k < K; k++) A[i][k] = -C[i][k];
  invert_in_place(A);
  multiply(A, L_f, C);
  multiply(A, R_v, D);
  std::memcpy(entries, A, sizeof(A));
  Vec* rest = entries + N * N;
  std::memcpy(rest, C[0], sizeof(P));
  std::memcpy(rest + K * K, D[K], sizeof(P));
  std::memcpy(rest + 2 * K * K, C[K], sizeof(P));
  std::memcpy(rest + 3 * K * K, D[0], sizeof(P));
  std::memcpy(P, D[K], sizeof(P));
}

// Reads LANES cells of each of LANES robots: lane g of x[0], x[step], ... is from row g.
inline void read_cells(const double* const* rows, Vec* x, int step) {
  Vec of_cells[LANES];
  for (int g = 0; g < LANES; g++) of_cells[g] = load(rows[g]);
  transpose(of_cells);
  for (int c = 0; c < LANES; c++) x[c * step] = of_cells[c];
}

inline void write_cells(const Vec* x, int step, double* const* rows) {
  Vec of_robots[LANES];
  for (int c = 0; c < LANES; c++) of_robots[c] = x[c * step];
  transpose(of_robots);
  for (int g = 0; g < LANES; g++) store(rows[g], of_robots[g]);
}

// The factors of the tail's conditions: tail_f and P_0.
template <int K>
void factorise_tail(const Factors<K, double>& x, const double* tail) {
  constexpr int N = 2 * K;
  double G_f[K][K];
  for (int i = 0; i < K; i++)
    for (int j = 0; j < K; j++) G_f[i][j] = tail[i * N + j];
  invert(G_f, x.tail_f);
  for (int i = 0; i < K; i++)
    for (int j = 0; j < K; j++) {
      double sum = 0.0;
      for (int m = 0; m < K; m++) sum -= x.tail_f[i * K + m] * tail[m * N + K + j];
      x.P[i * K + j] = sum;
    }
}

// The factors of the head's conditions: head_v and H_f. P is that of the head.
template <int K>
void factorise_head(const Factors<K, double>& x, const double* head, const double (&P)[K][K]) {
  constexpr int N = 2 * K;
  double H[K][K];
  for (int i = 0; i < K; i++)
    for (int j = 0; j < K; j++) {
      double sum = head[i * N + K + j];
      for (int m = 0; m < K; m++) sum += head[i * N + m] * P[m][j];
      H[i][j] = sum;
      x.H_f[i * K + j] = head[i * N + j];
    }
  invert(H, x.head_v);
}

// Factorises one robot. B, C and D follow from factors without P, which are computed for LANES cells
// at a time, and from E and W, which pass along the body:
//
//     G = [L_v, R_f]^-1,    F = -G L_f,    V = -G R_v,
//     E = (1 - F_v P)^-1,   W = F_f P E,   P_{c+1} = V_f + W V_v,
//     B = [E G_v, G_f + W G_v],    C = [E F_v, F_f + W F_v],    D = [E V_v, P_{c+1}]
template <int K>
void factorise_one(const double* left, const double* right, const double* tail, const double* head,
                   double* factors, int64_t cells) {
  constexpr int N = 2 * K;
  struct Tile {
    Vec G_v[K][N], G_f[K][N], F_v[K][K], F_f[K][K], V_v[K][K], V_f[K][K], E[K][K], W[K][K];
  };
  const int64_t stride = padded(cells);
  const Factors<K, double> x(factors, cells);
  Tile* tiles = work_of<Tile>(stride / LANES);
  for (int64_t first = 0; first < cells; first += LANES) {
    const int64_t inside = cells - first < LANES ? cells - first : LANES;
    const auto entry = [&](const double* matrix, int i, int j) {
      const double* at = matrix + (i * N + j) * cells + first;
      if (inside == LANES) return load(at);
      // A vector may read into the next row, but not beyond the matrix.
      if (i * N + j < N * N - LANES) return NUMBERS < inside ? load(at) : Vec{};
      Vec found{};
      std::memcpy(&found, at, inside * sizeof(double));
      return found;
    };
    Vec G[N][N], L_f[N][K], R_v[N][K], F[N][K], V[N][K];
    for (int i = 0; i < N; i++)
      for (int j = 0; j < K; j++) {
        L_f[i][j] = -entry(left, i, j);
        R_v[i][j] = -entry(right, i, K + j);
        G[i][j] = entry(left, i, K + j);
        G[i][K + j] = entry(right, i, j);
      }
    // The unit matrix beyond the head has a finite inverse; the right sides are zero there.
    for (int64_t c = inside; c < LANES; c++)
      for (int i = 0; i < N; i++) lanes(G[i][i])[c] = 1.0;
    invert_in_place(G);
    multiply(G, L_f, F);
    multiply(G, R_v, V);
    Tile& t = tiles[first / LANES];
    std::memcpy(t.G_v, G[0], sizeof(t.G_v));
    std::memcpy(t.G_f, G[K], sizeof(t.G_f));
    std::memcpy(t.F_v, F[0], sizeof(t.F_v));
    std::memcpy(t.F_f, F[K], sizeof(t.F_f));
    std::memcpy(t.V_v, V[0], sizeof(t.V_v));
    std::memcpy(t.V_f, V[K], sizeof(t.V_f));
    std::memset(t.E, 0, sizeof(t.E));
    std::memset(t.W, 0, sizeof(t.W));
  }
  factorise_tail(x, tail);
  double P[K][K];
  std::memcpy(P, x.P, sizeof(P));
  for (int64_t c = 0; c < cells; c++) {
    Tile& t = tiles[c / LANES];
    const auto of_cell = [&](Vec(&matrix)[K][K], double(&found)[K][K]) {
      for (int i = 0; i < K; i++)
        for (int j = 0; j < K; j++) found[i][j] = lanes(matrix[i][j])[c % LANES];
    };
    double F_v[K][K], F_f[K][K], V_v[K][K], E[K][K], P_E[K][K], W[K][K];
    of_cell(t.F_v, F_v);
    of_cell(t.F_f, F_f);
    of_cell(t.V_v, V_v);
    multiply_small(F_v, P, E);
    for (int i = 0; i < K; i++)
      for (int j = 0; j < K; j++) W[i][j] = (i == j ? 1.0 : 0.0) - E[i][j];
    if constexpr (K == 3) {
      invert_3(W, E);
    } else {
      invert_in_place(W);
      std::memcpy(E, W, sizeof(E));
    }
    multiply_small(P, E, P_E);
    multiply_small(F_f, P_E, W);
    multiply_small(W, V_v, P_E);
    of_cell(t.V_f, P);
    for (int i = 0; i < K; i++)
      for (int j = 0; j < K; j++) P[i][j] += P_E[i][j];
    for (int i = 0; i < K; i++)
      for (int j = 0; j < K; j++) {
        lanes(t.E[i][j])[c % LANES] = E[i][j];
        lanes(t.W[i][j])[c % LANES] = W[i][j];
      }
  }
  factorise_head(x, head, P);
  for (int64_t first = 0; first < cells; first += LANES) {
    Tile& t = tiles[first / LANES];
    Vec B_v[K][N], C_v[K][K], D_v[K][K];
    multiply(t.E, t.G_v, B_v);
    multiply(t.E, t.F_v, C_v);
    multiply(t.E, t.V_v, D_v);
    multiply_add(t.W, t.G_v, t.G_f);
    multiply_add(t.W, t.F_v, t.F_f);
    multiply_add(t.W, t.V_v, t.V_f);
    for (int i = 0; i < K; i++) {
      for (int j = 0; j < N; j++) {
        store(x.B + (i * N + j) * stride + first, B_v[i][j]);
        store(x.B + ((K + i) * N + j) * stride + first, t.G_f[i][j]);
      }
      for (int j = 0; j < K; j++) {
        store(x.C_v + (i * K + j) * stride + first, C_v[i][j]);
        store(x.D_f + (i * K + j) * stride + first, t.V_f[i][j]);
        for (int64_t c = 0; c < LANES; c++) {
          x.C_f(first + c)[i * K + j] = lanes(t.F_f[i][j])[c];
          x.D_v(first + c)[i * K + j] = lanes(D_v[i][j])[c];
        }
      }
    }
  }
}

// Factorises LANES robots.
template <int K>
void factorise_group(const double* const* left, const double* const* right,
                     const double* const* tail, const double* const* head, double* const* factors,
                     int64_t cells) {
  constexpr int N = 2 * K, entries = 8 * K * K;
  const int64_t stride = padded(cells);
  Vec* tile = work_of<Vec>(LANES * entries);
  double last[2 * LANES][LANES] = {};
  Vec P[K][K];
  for (int g = 0; g < LANES; g++) {
    const Factors<K, double> x(factors[g], cells);
    factorise_tail(x, tail[g]);
    for (int i = 0; i < K; i++)
      for (int j = 0; j < K; j++) lanes(P[i][j])[g] = x.P[i * K + j];
  }
  for (int64_t first = 0; first < cells; first += LANES) {
    const int64_t inside = cells - first < LANES ? cells - first : LANES;
    for (int e = 0; e < N * N; e++) {
      const double *l[LANES], *r[LANES];
      for (int g = 0; g < LANES; g++) {
        l[g] = left[g] + e * cells + first;
        r[g] = right[g] + e * cells + first;
        // A vector may read into the next row, but not beyond the matrix.
        if (e < N * N - LANES || inside == LANES) continue;
        std::memcpy(last[g], l[g], inside * sizeof(double));
        std::memcpy(last[LANES + g], r[g], inside * sizeof(double));
        l[g] = last[g];
        r[g] = last[LANES + g];
      }
      read_cells(l, tile + e, entries);
      read_cells(r, tile + N * N + e, entries);
    }
    for (int64_t c = 0; c < inside; c++) factorise_cell(tile + c * entries, P);
    std::memset(tile + inside * entries, 0, (LANES - inside) * entries * sizeof(Vec));
    for (int e = 0; e < N * N + N * K; e++) {
      double* rows[LANES];
      for (int g = 0; g < LANES; g++) rows[g] = factors[g] + e * stride + first;
      write_cells(tile + e, entries, rows);
    }
    for (int g = 0; g < LANES; g++) {
      const Factors<K, double> x(factors[g], cells);
      for (int64_t c = 0; c < LANES; c++)
        for (int e = 0; e < N * K; e++)
          x.C_f(first + c)[e] = lanes(tile[c * entries + N * N + N * K + e])[g];
    }
  }
  for (int g = 0; g < LANES; g++) {
    double of_robot[K][K];
    for (int i = 0; i < K; i++)
      for (int j = 0; j < K; j++) of_robot[i][j] = lanes(P[i][j])[g];
    factorise_head({factors[g], cells}, head[g], of_robot);
  }
}

// sums[i] (+)= sum_j a_ij x_j in all cells, for a matrix of M x N rows.
template <bool ADD, int M, int N>
[[gnu::noinline]] void apply(const double* a, const double* x, double* sums, int64_t stride) {
  for (int64_t first = 0; first < stride; first += LANES) {
    Vec of_x[N];
#pragma GCC unroll 16
    for (int j = 0; j < N; j++) of_x[j] = load(x + j * stride + first);
#pragma GCC unroll 1
    for (int i = 0; i < M; i++) {
      Vec sum = ADD ? load(sums + i * stride + first) : Vec{};
#pragma GCC unroll 16
      for (int j = 0; j < N; j++) sum += load(a + (i * N + j) * stride + first) * of_x[j];
      store(sums + i * stride + first, sum);
    }
  }
}

// sums[j] = sum_i a_ij x_i in all cells.
template <int M, int N>
[[gnu::noinline]] void apply_transposed(const double* a, const double* x, double* sums,
                                        int64_t stride) {
  for (int64_t first = 0; first < stride; first += LANES) {
    Vec of_x[M];
#pragma GCC unroll 16
    for (int i = 0; i < M; i++) of_x[i] = load(x + i * stride + first);
#pragma GCC unroll 1
    for (int j = 0; j < N; j++) {
      Vec sum{};
#pragma GCC unroll 16
      for (int i = 0; i < M; i++) sum += load(a + (i * N + j) * stride + first) * of_x[i];
      store(sums + j * stride + first, sum);
    }
  }
}

// Copies n numbers. The copies of a robot's rows are short, so a call of memcpy would take longer.
inline void copy(const double* from, double* to, int64_t n) {
  if (n < LANES) {
    for (int64_t c = 0; c < n; c++) to[c] = from[c];
    return;
  }
  for (int64_t c = 0; c < n - LANES; c += LANES) store(to + c, load(from + c));
  store(to + n - LANES, load(from + n - LANES));
}

// Copies rows of `cells` numbers into rows of `stride` numbers, and sets the rest to zero.
template <int ROWS>
void copy_rows(const double* from, int64_t from_stride, double* to, int64_t cells, int64_t stride) {
  for (int i = 0; i < ROWS; i++) {
    copy(from + i * from_stride, to + i * stride, cells);
    for (int64_t c = cells; c < stride; c++) to[i * stride + c] = 0.0;
  }
}

// Adds the product of a K x K matrix, or of its transpose, and a vector.
template <int K>
inline void add_product(const double* a, const double* x, double* sums) {
  for (int i = 0; i < K; i++)
    for (int j = 0; j < K; j++) sums[i] += a[i * K + j] * x[j];
}
template <int K>
inline void add_transposed_product(const double* a, const double* x, double* sums) {
  for (int j = 0; j < K; j++)
    for (int i = 0; i < K; i++) sums[j] += a[i * K + j] * x[i];
}

// Passes along the bodies of G robots: at = a_c at + sums_c in one cell after another. Keeps `at` of
// before the cell in `before`, and of after the cell in `sums`. Each value needs the one before, so
// the processor computes those of G robots at the same time.
template <int K, int G>
inline void pass_along(const double* const (&a)[G], double* const (&sums)[G],
                       double* const (&before)[G], double (&at)[G][K], int64_t stride,
                       int64_t first, int64_t end, int64_t step) {
  for (int64_t c = first; c != end; c += step)
#pragma GCC unroll 4
    for (int g = 0; g < G; g++) {
      double next[K];
#pragma GCC unroll 8
      for (int i = 0; i < K; i++) {
        before[g][i * stride + c] = at[g][i];
        next[i] = sums[g][i * stride + c];
#pragma GCC unroll 8
        for (int j = 0; j < K; j++) next[i] += a[g][(2 * c * K + i) * K + j] * at[g][j];
      }
#pragma GCC unroll 8
      for (int i = 0; i < K; i++) sums[g][i * stride + c] = at[g][i] = next[i];
    }
}

// Solves for G robots.
template <int K, int G>
void solve(const double* const* factors, const double* const* r, const double* const* tail,
           const double* const* head, double* const* y, int64_t cells) {
  constexpr int N = 2 * K;
  const int64_t stride = padded(cells), nodes = cells + 1, rows = 2 * N * stride;
  double* work = work_of<double>(G * rows + N * stride);
  double *motion[G], *forces[G], *p[G], *v[G], at[G][K] = {}, first[G][K];
  const double *C_f[G], *D_v[G];
  for (int g = 0; g < G; g++) {
    const Factors<K, const double> x(factors[g], cells);
    double* rhs = work + G * rows;
    motion[g] = work + g * rows;
    forces[g] = motion[g] + K * stride;
    p[g] = motion[g] + N * stride;
    v[g] = p[g] + K * stride;
    C_f[g] = x.C_f(0);
    D_v[g] = x.D_v(0);
    copy_rows<N>(r[g], cells, rhs, cells, stride);
    apply<false, N, N>(x.B, rhs, motion[g], stride);
    add_product<K>(x.tail_f, tail[g], at[g]);
    std::memcpy(first[g], at[g], sizeof(at[g]));
    for (int i = 0; i < K; i++)
      for (int64_t c = cells; c < stride; c++) p[g][i * stride + c] = v[g][i * stride + c] = 0.0;
  }
  pass_along<K, G>(C_f, forces, p, at, stride, 0, cells, 1);
  for (int g = 0; g < G; g++) {
    const Factors<K, const double> x(factors[g], cells);
    apply<true, K, K>(x.C_v, p[g], motion[g], stride);
    double taken[K] = {}, rest[K];
    add_product<K>(x.H_f, at[g], taken);
    for (int i = 0; i < K; i++) {
      rest[i] = head[g][i] - taken[i];
      at[g][i] = 0.0;
    }
    add_product<K>(x.head_v, rest, at[g]);
    for (int i = 0; i < K; i++) y[g][(K + i) * nodes + cells] = at[g][i];
  }
  pass_along<K, G>(D_v, motion, v, at, stride, cells - 1, -1, -1);
  for (int g = 0; g < G; g++) {
    const Factors<K, const double> x(factors[g], cells);
    apply<true, K, K>(x.D_f, v[g], forces[g], stride);
    add_product<K>(x.P, at[g], first[g]);
    for (int i = 0; i < K; i++) {
      double *f = y[g] + i * nodes, *motions = y[g] + (K + i) * nodes;
      f[0] = first[g][i];
      copy(forces[g] + i * stride, f + 1, cells);
      copy(motion[g] + i * stride, motions, cells);
    }
  }
}

inline Vec absolute(Vec x) { return (Vec)((Lanes)x & INT64_MAX); }

// The largest change |step| / magnitude in each lane. Products replace the quotients in the
// comparisons, because they are faster.
struct Largest {
  Vec step{}, magnitude = Vec{} + 1.0, invalid{};

  void include(Vec change, Vec size) {
    const Vec by = absolute(change);
    const Lanes larger = by * magnitude > step * size;
    step = larger ? by : step;
    magnitude = larger ? size : magnitude;
    invalid += 0.0 * by;
  }

  // Returns the largest change of all lanes, or NaN if a change is not finite.
  double of_all() const {
    const Vec ratio = step / magnitude, unknown = invalid + 0.0 * ratio;
    double found = 0.0;
    for (int lane = 0; lane < LANES; lane++)
      found = (ratio[lane] > found ? ratio[lane] : found) + unknown[lane];
    return found;
  }
};

// A step of Newton's method: better = y - change. `better` may be y. Returns the largest change of an
// unknown relative to max(scale, |y|), or NaN if one is not finite.
template <int K>
double correct(const double* y, const double* scale, const double* change, double* better,
               int64_t cells) {
  const int64_t nodes = cells + 1;
  Largest largest;
  const auto improve = [&](Vec before, Vec step, double least) {
    const Vec size = absolute(before);
    largest.include(step, size > least ? size : Vec{} + least);
    return before - step;
  };
  for (int i = 0; i < 2 * K; i++) {
    const double *before = y + i * nodes, *step = change + i * nodes;
    double* after = better + i * nodes;
    if (nodes < LANES) {
      Vec some{}, some_step{};
      std::memcpy(&some, before, nodes * sizeof(double));
      std::memcpy(&some_step, step, nodes * sizeof(double));
      some = improve(some, some_step, scale[i]);
      std::memcpy(after, &some, nodes * sizeof(double));
      continue;
    }
    // The last nodes come first, because the others may overwrite some of their values.
    const int64_t last = nodes - LANES;
    const Vec end = improve(load(before + last), load(step + last), scale[i]);
    for (int64_t c = 0; c < last; c += LANES)
      store(after + c, improve(load(before + c), load(step + c), scale[i]));
    store(after + last, end);
  }
  return largest.of_all();
}

// The transpose of `solve`: from (2K, nodes) to the cells, the tail and the head.
template <int K>
void solve_transposed(const Factors<K, const double>& x, const double* y, double* r, double* tail,
                      double* head, int64_t cells) {
  constexpr int N = 2 * K;
  const int64_t stride = x.stride, nodes = cells + 1;
  double* u = work_of<double>(3 * N * stride);  // derivatives by (v_c, f_{c+1})
  double *rhs = u + N * stride, *through = rhs + N * stride, *of_p = through + K * stride;
  copy_rows<K>(y + K * nodes, nodes, u, cells, stride);
  copy_rows<K>(y + 1, nodes, u + K * stride, cells, stride);
  // From the tail: derivatives with respect to v_c collect those of all nodes behind.
  apply_transposed<K, K>(x.D_f, u + K * stride, through, stride);
  double at[K], f[K];
  for (int i = 0; i < K; i++) {
    at[i] = y[(K + i) * nodes];
    f[i] = y[i * nodes];
  }
  add_transposed_product<K>(x.P, f, at);
  for (int64_t c = 0; c < cells; c++) {
    const double* D_v = x.D_v(c);
    double next[K];
    for (int j = 0; j < K; j++) {
      u[j * stride + c] = at[j];
      next[j] = y[(K + j) * nodes + c + 1] + through[j * stride + c];
    }
    add_transposed_product<K>(D_v, at, next);
    std::memcpy(at, next, sizeof(at));
  }
  double p[K] = {};
  for (int j = 0; j < K; j++) head[j] = 0.0;
  add_transposed_product<K>(x.head_v, at, head);
  add_transposed_product<K>(x.H_f, head, p);
  for (int j = 0; j < K; j++) p[j] = -p[j];
  // From the head: derivatives with respect to p_c collect those of all nodes ahead.
  apply_transposed<K, K>(x.C_v, u, of_p, stride);
  for (int64_t c = cells - 1; c >= 0; c--) {
    const double* C_f = x.C_f(c);
    double force[K], next[K];
    for (int i = 0; i < K; i++) {
      force[i] = u[(K + i) * stride + c] += p[i];
      next[i] = of_p[i * stride + c];
    }
    add_transposed_product<K>(C_f, force, next);
    std::memcpy(p, next, sizeof(p));
  }
  apply_transposed<N, N>(x.B, u, rhs, stride);
  for (int i = 0; i < N; i++) std::memcpy(r + i * cells, rhs + i * stride, cells * sizeof(double));
  for (int i = 0; i < K; i++) {
    f[i] += p[i];
    tail[i] = 0.0;
  }
  add_transposed_product<K>(x.tail_f, f, tail);
}

using In = ffi::Buffer<ffi::F64>;
using Out = ffi::ResultBuffer<ffi::F64>;

// The robots of a batch: leading axes of all buffers, some of them of length 1 in an input.
struct Batch {
  ffi::Span<const int64_t> lengths;
  int64_t robots = 1;
  mutable int used = 0;

  Batch(ffi::Span<const int64_t> dims, size_t own) : lengths(dims.first(dims.size() - own)) {
    for (const int64_t length : lengths) robots *= length;
  }

  // Returns the place of each robot's data in a buffer whose last `own` axes belong to a robot. Each
  // buffer of a call has a vector of its own, which stays for the next call of the thread.
  const double* const* rows(In x, size_t own) const {
    static thread_local std::vector<const double*> places[7];
    std::vector<const double*>& found = places[used++];
    const auto dims = x.dimensions();
    int64_t size = 1;
    for (size_t i = dims.size() - own; i < dims.size(); i++) size *= dims[i];
    found.assign(1, x.typed_data());
    for (size_t i = lengths.size(); i-- > 0;) {
      const int64_t step = dims[i] == 1 ? 0 : size;
      size *= dims[i];
      const size_t before = found.size();
      for (int64_t k = 1; k < lengths[i]; k++)
        for (size_t m = 0; m < before; m++) found.push_back(found[m] + k * step);
    }
    return found.data();
  }
};

template <int K>
void factorise_batch(In left, In right, In tail, In head, Out factors) {
  const int64_t cells = left.dimensions().back();
  const Batch batch(factors->dimensions(), 1);
  const auto l = batch.rows(left, 3), r = batch.rows(right, 3);
  const auto t = batch.rows(tail, 2), h = batch.rows(head, 2);
  std::vector<double*> to(batch.robots);
  for (int64_t i = 0; i < batch.robots; i++)
    to[i] = factors->typed_data() + i * factor_size<K>(cells);
  int64_t i = 0;
  for (; i + LANES <= batch.robots; i += LANES)
    factorise_group<K>(&l[i], &r[i], &t[i], &h[i], &to[i], cells);
  for (; i < batch.robots; i++) factorise_one<K>(l[i], r[i], t[i], h[i], to[i], cells);
}

constexpr int TOGETHER = 4;

// Solves for all robots. The solution of robot i is at to(i), and finish(i) is called after it. Up to
// TOGETHER robots, from a multiple of TOGETHER, are solved before the first of them is finished.
template <int K, class To, class Finish>
void solve_each(const Batch& batch, In factors, In cells, In tail, In head, To to, Finish finish) {
  const int64_t count = cells.dimensions().back();
  const auto f = batch.rows(factors, 1), r = batch.rows(cells, 2);
  const auto t = batch.rows(tail, 1), h = batch.rows(head, 1);
  int64_t i = 0;
  for (; i + TOGETHER <= batch.robots; i += TOGETHER) {
    double* y[TOGETHER];
    for (int g = 0; g < TOGETHER; g++) y[g] = to(i + g);
    solve<K, TOGETHER>(&f[i], &r[i], &t[i], &h[i], y, count);
    for (int g = 0; g < TOGETHER; g++) finish(i + g);
  }
  for (; i < batch.robots; i++) {
    double* y[1] = {to(i)};
    solve<K, 1>(&f[i], &r[i], &t[i], &h[i], y, count);
    finish(i);
  }
}

template <int K>
void solve_batch(In factors, In cells, In tail, In head, Out y) {
  const int64_t size = 2 * K * (cells.dimensions().back() + 1);
  const auto to = [&](int64_t i) { return y->typed_data() + i * size; };
  solve_each<K>(Batch(y->dimensions(), 2), factors, cells, tail, head, to, [](int64_t) {});
}

template <int K>
void correct_batch(In factors, In cells, In tail, In head, In scale, In y, In sizes, Out better,
                   Out last_sizes) {
  const int64_t count = cells.dimensions().back(), size = 2 * K * (count + 1);
  const Batch batch(better->dimensions(), 2);
  const auto scales = batch.rows(scale, 2), from = batch.rows(y, 2), before = batch.rows(sizes, 1);
  static thread_local std::vector<double> changes;
  changes.resize(TOGETHER * size);
  const auto to = [&](int64_t i) { return changes.data() + i % TOGETHER * size; };
  solve_each<K>(batch, factors, cells, tail, head, to, [&](int64_t i) {
    double* last = last_sizes->typed_data() + 2 * i;
    last[0] = before[i][1];
    last[1] = correct<K>(from[i], scales[i], to(i), better->typed_data() + i * size, count);
  });
}

template <int K>
void solve_transposed_batch(In factors, In y, Out cells, Out tail, Out head) {
  const int64_t count = cells->dimensions().back();
  const Batch batch(tail->dimensions(), 1);
  const auto f = batch.rows(factors, 1), from = batch.rows(y, 2);
  for (int64_t i = 0; i < batch.robots; i++)
    solve_transposed<K>({f[i], count}, from[i], cells->typed_data() + i * 2 * K * count,
                        tail->typed_data() + i * K, head->typed_data() + i * K,
                        count);
}

// Calls run(K), with K as a constant of the compiler.
template <class Run>
ffi::Error with_forces(int64_t k, Run run) {
  if (k == 3)
    run(std::integral_constant<int, 3>());
  else if (k == 6)
    run(std::integral_constant<int, 6>());
  else
    return ffi::Error::InvalidArgument("the block solver supports 3 or 6 forces per node");
  return ffi::Error::Success();
}

ffi::Error Factorise(In left, In right, In tail, In head, Out factors) {
  const int64_t k = tail.dimensions().back() / 2, cells = left.dimensions().back();
  if (factors->dimensions().back() != (k == 3 ? factor_size<3>(cells) : factor_size<6>(cells)))
    return ffi::Error::InvalidArgument("the size of the factors is wrong");
  return with_forces(k, [&](auto K) { factorise_batch<K()>(left, right, tail, head, factors); });
}

ffi::Error Solve(In factors, In cells, In tail, In head, Out y) {
  return with_forces(tail.dimensions().back(),
                     [&](auto K) { solve_batch<K()>(factors, cells, tail, head, y); });
}

ffi::Error Correct(In factors, In cells, In tail, In head, In scale, In y, In sizes, Out better,
                   Out last_sizes) {
  return with_forces(tail.dimensions().back(), [&](auto K) {
    correct_batch<K()>(factors, cells, tail, head, scale, y, sizes, better, last_sizes);
  });
}

ffi::Error SolveTransposed(In factors, In y, Out cells, Out tail, Out head) {
  return with_forces(tail->dimensions().back(), [&](auto K) {
    solve_transposed_batch<K()>(factors, y, cells, tail, head);
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(
    slider_factorise, Factorise,
    ffi::Ffi::Bind().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(
    slider_solve, Solve,
    ffi::Ffi::Bind().Arg<In>().Arg<In>().Arg<In>().Arg<In>().Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(slider_correct, Correct,
                              ffi::Ffi::Bind()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Ret<In>()
                                  .Ret<In>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(slider_solve_transposed, SolveTransposed,
                              ffi::Ffi::Bind()
                                  .Arg<In>()
                                  .Arg<In>()
                                  .Ret<In>()
                                  .Ret<In>()
                                  .Ret<In>());

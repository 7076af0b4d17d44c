// The gradient of SPH and its corrections, as algebra on base sums of the kernel,
//
//   m[value, α] = Σ V s^α Ŵ,   m[i, α] = −Σ V s^α ∂ᵢŴ.
//
// A corrected weight is Σ c[δ, γ] s^γ (∓∂^δ Ŵ) V: the coefficients c are found here, by the same
// lines for exact rationals (integrals) and for numbers that remember (sums over particles).

const VALUE = "value";

function multiIndices(dim, degree) {
  const found = [];
  for (let n = 0; n <= degree; n++) {
    for (let i = n; i >= 0; i--) {
      if (dim === 1) {
        if (i === n) found.push([n]);
        continue;
      }
      for (let j = n - i; j >= 0; j--) {
        if (dim === 2) {
          if (i + j === n) found.push([i, j]);
          continue;
        }
        found.push([i, j, n - i - j]);
      }
    }
  }
  return found;
}

const unit = (dim, axis, n = 1) => Array.from({ length: dim }, (_, i) => (i === axis ? n : 0));
const added = (a, b) => a.map((x, i) => x + b[i]);
const lowered = (a, axis) => a.map((x, i) => (i === axis ? x - 1 : x));

/** Base sums, each made once, when it is first asked for. */
class Sums {
  constructor(make) {
    this.make = make;
    this.known = new Map();
  }

  get(term, alpha) {
    const key = `${term}:${alpha}`;
    if (!this.known.has(key)) this.known.set(key, { term, alpha, sum: this.make(term, alpha) });
    return this.known.get(key).sum;
  }
}

/** Σ c[δ, γ] of a weight: rows { term, alpha, c }. */
class Part {
  constructor() {
    this.rows = new Map();
  }

  add(term, alpha, c) {
    const key = `${term}:${alpha}`;
    const row = this.rows.get(key);
    this.rows.set(key, { term, alpha, c: row ? row.c.plus(c) : c });
    return this;
  }

  /** M_α = Σ c[δ, γ] m[δ, α + γ]. */
  moment(sums, alpha) {
    return [...this.rows.values()]
      .map(({ term, alpha: gamma, c }) => c.times(sums.get(term, added(alpha, gamma))))
      .reduce((total, x) => total.plus(x));
  }
}

/** X with matrix · X = columns, by elimination with the largest pivots. */
function solve(matrix, columns) {
  const n = matrix.length;
  const rows = matrix.map((row, i) => [...row, ...columns[i]]);
  const largest = rows.map((row) => Math.max(...row.slice(0, n).map((x) => x.size)));
  for (let k = 0; k < n; k++) {
    let best = k;
    for (let i = k + 1; i < n; i++) if (rows[i][k].size > rows[best][k].size) best = i;
    [rows[k], rows[best]] = [rows[best], rows[k]];
    [largest[k], largest[best]] = [largest[best], largest[k]];
    const pivot = rows[k][k];
    if (!(pivot.size > 1e-10 * largest[k])) {
      throw new Error(
        "the correction is singular here: too few neighbours, or neighbours on one line" +
          " or plane; take a smaller Δx/h, or a lower correction",
      );
    }
    for (let j = k + 1; j < rows[k].length; j++) rows[k][j] = rows[k][j].over(pivot);
    for (let i = 0; i < n; i++) {
      const factor = rows[i][k];
      if (i === k || factor.isZero) continue;
      for (let j = k + 1; j < rows[k].length; j++) {
        if (!rows[k][j].isZero) rows[i][j] = rows[i][j].minus(factor.times(rows[k][j]));
      }
    }
  }
  return rows.map((row) => row.slice(n));
}

/** m of the polynomial that multiplies the kernel; null if there is none. */
function polynomialDegree(correction) {
  if (correction.startsWith("rkpm-")) return Number(correction.slice(5));
  return correction.endsWith("shepard") ? 0 : null;
}

/** The weights of ∂₁ … ∂_d, one Part each; `number` makes a number of the kind that the sums are. */
function gradientParts(correction, dim, sums, number) {
  const axes = [...Array(dim).keys()];
  const degree = polynomialDegree(correction);
  const parts =
    degree === null
      ? axes.map((i) => new Part().add(i, unit(dim), number(1)))
      : reproducing(degree, dim, sums, number);
  if (!correction.startsWith("csph")) return parts;
  const slopes = parts.map((part) => axes.map((j) => part.moment(sums, unit(dim, j))));
  const inverse = solve(
    slopes,
    axes.map((i) => axes.map((j) => number(Number(i === j)))),
  );
  return inverse.map((row) => {
    const result = new Part();
    parts.forEach((part, j) => {
      for (const { term, alpha, c } of part.rows.values()) result.add(term, alpha, row[j].times(c));
    });
    return result;
  });
}

/**
 * Exact derivatives of the kernel Σ c_a s^a Ŵ that reproduces polynomials of the degree, with respect
 * to the point of evaluation: P c = e₀ with P_ab = m[value, a + b], and P ∂ᵢc = −(∂ᵢP) c.
 */
function reproducing(degree, dim, sums, number) {
  const axes = [...Array(dim).keys()];
  const basis = multiIndices(dim, degree);
  const matrix = basis.map((a) => basis.map((b) => sums.get(VALUE, added(a, b))));
  const c = solve(
    matrix,
    basis.map((_, n) => [number(Number(n === 0))]),
  ).map(([x]) => x);
  const slope = (axis, alpha) =>
    alpha[axis]
      ? sums.get(axis, alpha).minus(sums.get(VALUE, lowered(alpha, axis)).scaled(alpha[axis]))
      : sums.get(axis, alpha);
  const columns = basis.map((a) =>
    axes.map((axis) =>
      basis
        .map((b, n) => slope(axis, added(a, b)).times(c[n]))
        .reduce((total, x) => total.plus(x))
        .scaled(-1),
    ),
  );
  const changes = solve(matrix, columns);
  return axes.map((axis) => {
    const part = new Part();
    basis.forEach((a, n) => {
      part.add(axis, a, c[n]).add(VALUE, a, changes[n][axis]);
      if (a[axis]) part.add(VALUE, lowered(a, axis), c[n].scaled(-a[axis]));
    });
    return part;
  });
}

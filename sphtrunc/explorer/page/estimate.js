// The error of the gradient for a kernel, a lattice, a form and a correction: moments, and the parts
// of the rms error of a wave. Disorder is of first order: σ² Σ_b |∂E/∂u_b|² over the displacements.
//
// Signals are functions of s₁, the offset along the first axis in h: a power, or the two parts
// cos κs₁, sin κs₁ of a wave of any phase, κ = 2π h/λ.

const ORDERS = 60; // of the wave, in the continuous limit

/** What the sums see of A: how often A_a is added to A_b − A_a. */
const COPIES = { difference: 0, standard: 1, paired: 1, symmetric: 2 };

const power = (n) => [{ f: (x) => x ** n, slope: (x) => (n ? n * x ** (n - 1) : 0) }];
const wave = (kappa) => [
  { f: (x) => Math.cos(kappa * x), slope: (x) => -kappa * Math.sin(kappa * x) },
  { f: (x) => Math.sin(kappa * x), slope: (x) => kappa * Math.cos(kappa * x) },
];

/** The particles around one of them, and everything that does not depend on the signal. */
class Estimate {
  constructor(kernel, lattice, form, correction, dxOverH) {
    if (form === "paired" && !lattice.pairs) {
      throw new Error(
        "the paired form takes neighbours at ±s together, and this lattice has no such" +
          " pairs; take the form standard",
      );
    }
    Object.assign(this, { kernel, lattice, form, correction, dxOverH, dim: lattice.dim });
    this.offsets = neighbours(lattice, dxOverH, kernel.support);
    this.volume = dxOverH ** this.dim;
    const sigma = kernel.normalisation(this.dim);
    const factors = (s) => {
      const q = Math.hypot(...s);
      const own = q === 0;
      const slope = own ? 0 : (sigma * kernel.shape(q, 1)) / q;
      const curve = own ? 0 : (sigma * kernel.shape(q, 2) - slope) / (q * q);
      return [sigma * kernel.shape(q), slope, curve]; // Ŵ, Ŵ′/q, (Ŵ′/q)′/q
    };
    this.factors = this.offsets.map(factors);
    this.trace = new Trace();
    this.sums = new Sums((term, alpha) => this.trace.number(this.total(term, alpha)));
    this.parts = gradientParts(correction, this.dim, this.sums, (n) => this.trace.number(n));
    this.own = this.parts.map((part) =>
      this.sampled([...part.rows.values()].map(({ term, alpha, c }) => [c.value, term, alpha])),
    );
  }

  /** Particles within the support, the target counted. */
  get count() {
    return this.offsets.length;
  }

  /** m[term, α], times a function of s₁. */
  total(term, alpha, f = null) {
    const beta = term === VALUE ? alpha : added(alpha, unit(this.dim, term));
    const which = term === VALUE ? 0 : 1;
    let sum = 0;
    this.offsets.forEach((s, b) => {
      let value = this.factors[b][which];
      beta.forEach((n, axis) => {
        for (let i = 0; i < n; i++) value *= s[axis];
      });
      sum += f ? value * f(s[0]) : value;
    });
    return (term === VALUE ? 1 : -1) * this.volume * sum;
  }

  /** g = Σ c · (s^α Ŵ or −s^α ∂ᵢŴ) and ∇g at every particle, from rows [c, term, α]. */
  sampled(rows) {
    const { dim } = this;
    const terms = rows
      .filter(([c]) => c)
      .map(([c, term, alpha]) =>
        term === VALUE
          ? { c, which: 0, beta: alpha }
          : { c: -c, which: 1, beta: added(alpha, unit(dim, term)) },
      );
    const most = Math.max(0, ...terms.flatMap(({ beta }) => beta));
    const powers = Array.from({ length: dim }, () => new Float64Array(most + 1).fill(1));
    return this.offsets.map((s, b) => {
      const f = this.factors[b];
      for (let axis = 0; axis < dim; axis++) {
        for (let n = 1; n <= most; n++) powers[axis][n] = powers[axis][n - 1] * s[axis];
      }
      let value = 0;
      let radial = 0;
      const slope = Array(dim).fill(0);
      for (const { c, which, beta } of terms) {
        let monomial = c;
        for (let axis = 0; axis < dim; axis++) monomial *= powers[axis][beta[axis]];
        value += monomial * f[which];
        radial += monomial * f[which + 1];
        for (let axis = 0; axis < dim; axis++) {
          if (!beta[axis]) continue;
          let rest = c * beta[axis] * f[which];
          for (let j = 0; j < dim; j++) rest *= powers[j][beta[j] - Number(j === axis)];
          slope[axis] += rest;
        }
      }
      for (let axis = 0; axis < dim; axis++) slope[axis] += radial * s[axis];
      return { value, slope };
    });
  }

  /** The field as the form sees it, at s₁. */
  seen({ f }) {
    const rest = (COPIES[this.form] - 1) * f(0);
    if (this.form === "paired") return (x) => 0.5 * (f(x) - f(-x));
    return (x) => f(x) + rest;
  }

  /** The estimate of ∂ᵢ of a signal, in units of 1/h. */
  estimate(axis, signal) {
    const seen = this.seen(signal);
    return (
      this.volume *
      this.offsets.reduce((sum, s, b) => sum + this.own[axis][b].value * seen(s[0]), 0)
    );
  }

  /** Σ_b |∂E/∂u_b|², u in Δx: times σ² it is the variance of the estimate of ∂ᵢ of a signal. */
  sensitivity(axis, signal) {
    const { dim, volume, dxOverH } = this;
    const seen = this.seen(signal);
    const rows = [...this.parts[axis].rows.values()];
    const change = this.trace.back(
      rows.map(({ term, alpha, c }) => [c, this.total(term, alpha, seen)]),
    );
    const others =
      this.correction === "none"
        ? null
        : this.sampled(
            [...this.sums.known.values()].map(({ term, alpha, sum }) => [
              change[sum.index],
              term,
              alpha,
            ]),
          );
    const target = Array(dim).fill(0);
    let square = 0;
    this.offsets.forEach((s, b) => {
      if (s.every((x) => x === 0)) return;
      const { value, slope } = this.own[axis][b];
      const field = seen(s[0]);
      for (let i = 0; i < dim; i++) {
        let move = slope[i] * field + (i ? 0 : value * signal.slope(s[0]));
        if (others) move += others[b].slope[i];
        move *= volume * dxOverH;
        target[i] -= move;
        square += move * move;
      }
    });
    return square + target.reduce((sum, x) => sum + x * x, 0);
  }

  /** M_n along the first axis, n = 0 … 3, and what their standard deviation is per σ/Δx. */
  moments(disorder = true) {
    return [0, 1, 2, 3].map((n) => {
      const [signal] = power(n);
      return {
        mean: this.estimate(0, signal),
        spread: disorder ? Math.sqrt(this.sensitivity(0, signal)) : null,
      };
    });
  }

  /** The rms error of a wave, over phases and displacements, relative to the largest gradient. */
  split(hOverLambda, jitter) {
    const kappa = 2 * Math.PI * hOverLambda;
    const smooth = smoothing(this.kernel, this.dim, this.correction, kappa);
    let [still, lattice, variance] = [0, 0, 0];
    for (let axis = 0; axis < this.dim; axis++) {
      wave(kappa).forEach((signal, part) => {
        const exact = axis === 0 && part === 1 ? kappa : 0;
        const error = this.estimate(axis, signal) - exact;
        still += error ** 2;
        lattice += (error - (exact ? smooth : 0)) ** 2;
        if (jitter) variance += jitter ** 2 * this.sensitivity(axis, signal);
      });
    }
    const scale = 1 / (Math.SQRT2 * kappa);
    return {
      total: scale * Math.sqrt(still + variance),
      smoothing: scale * Math.abs(smooth),
      discretisation: scale * Math.sqrt(lattice),
      disorder: scale * Math.sqrt(variance),
    };
  }
}

const limits = new WeakMap();

/** Taylor coefficients M_n/n! − exact, n = 1, 3, …, of the gradient for Δx/h → 0: exact, then floats. */
function limitSeries(kernel, dim, correction) {
  if (!limits.has(kernel)) limits.set(kernel, new Map());
  const known = limits.get(kernel);
  const key = `${dim}:${correction}`;
  if (!known.has(key)) {
    const whole = (n) => new Rational(BigInt(n));
    const sums = new Sums((term, alpha) => integralOf(kernel, dim, term, alpha));
    const [part] = gradientParts(correction, dim, sums, whole);
    const series = [];
    let factorial = ONE;
    for (let n = 1; n < ORDERS; n += 2) {
      if (n > 1) factorial = factorial.scaled(n * (n - 1));
      const moment = part.moment(sums, unit(dim, 0, n)).over(factorial);
      series.push(moment.minus(n === 1 ? ONE : ZERO).toNumber());
    }
    known.set(key, series);
  }
  return known.get(key);
}

/** The error of the gradient of sin κs₁ for Δx/h → 0, in units of 1/h. */
function smoothing(kernel, dim, correction, kappa) {
  const series = limitSeries(kernel, dim, correction);
  return kappa * series.reduceRight((sum, c) => sum * -(kappa ** 2) + c, 0);
}

/** A base sum with the sum replaced by the integral, exactly, by isotropy. */
function integralOf(kernel, dim, term, alpha) {
  const beta = term === VALUE ? alpha : added(alpha, unit(dim, term));
  if (beta.some((n) => n % 2)) return ZERO;
  let mean = ONE; // of e^β over directions: ∏(β_i − 1)!!/(d(d+2)…)
  let size = 0;
  for (const n of beta) {
    for (let i = 1; i < n; i += 2) {
      mean = mean.times(new Rational(BigInt(i), BigInt(dim + size)));
      size += 2;
    }
  }
  return term === VALUE
    ? mean.times(kernel.moment(size, dim))
    : mean.times(kernel.slopeMoment(size - 1, dim)).scaled(-1);
}

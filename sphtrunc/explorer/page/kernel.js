// Kernels: exact shapes w(q), and the one place where they become floats.

/** ∫ f(|s|) d^d s = SPHERE[d] ∫ f(q) q^{d−1} dq. */
const SPHERE = [0, 2, 2 * Math.PI, 4 * Math.PI];
const BALL = [0, 2, Math.PI, (4 * Math.PI) / 3];
const DERIVATIVES = 4; // w, w′, w″, w‴
const CUTS = 8; // no part of a piece is wider than this part of the support

class Kernel {
  /** knots 0 = k₀ < … < κ and a polynomial between each pair, all exact. */
  constructor(name, knots, pieces) {
    if (knots.length < 2 || !knots[0].isZero) throw new Error("expected knots that begin at 0");
    knots.slice(1).forEach((knot, i) => {
      if (knot.compare(knots[i]) <= 0) {
        throw new Error(`${knot} follows ${knots[i]}, expected increasing knots`);
      }
    });
    while (pieces.length && !pieces[pieces.length - 1].length) {
      pieces = pieces.slice(0, -1);
      knots = knots.slice(0, -1);
    }
    if (!pieces.length) throw new Error("every piece is zero, expected a kernel that is not");
    this.name = name;
    this.knots = knots;
    this.pieces = pieces;
    this.slopes = pieces.map(derivativeOf);
    this.exactSupport = knots[knots.length - 1];
    this.support = this.exactSupport.toNumber();
    this.integrals = new Map();
    this.tabulate();
  }

  /** ∫ q^power f dq over the support, f = w or w′, exactly: whole numbers over one denominator. */
  integral(what, power) {
    const name = what + power;
    if (!this.integrals.has(name)) this.integrals.set(name, this.integrate(this[what], power));
    return this.integrals.get(name);
  }

  integrate(pieces, power) {
    const common = (x, y) => (x / gcd(x, y)) * y;
    const scale = this.knots.reduce((all, k) => common(all, k.bottom), 1n);
    const ends = this.knots.map((k) => k.top * (scale / k.bottom));
    const most = power + Math.max(...pieces.map((p) => p.length));
    const lengths = Array.from({ length: most - power }, (_, j) => BigInt(power + 1 + j));
    const divisor = lengths.reduce(common, 1n);
    return pieces.reduce((total, piece, i) => {
      const bottom = piece.reduce((all, c) => common(all, c.bottom), 1n);
      let sum = 0n;
      piece.forEach((c, j) => {
        const n = lengths[j];
        const step = ends[i + 1] ** n - ends[i] ** n;
        sum += c.top * (bottom / c.bottom) * step * scale ** (BigInt(most) - n) * (divisor / n);
      });
      return total.plus(new Rational(sum, bottom * scale ** BigInt(most) * divisor));
    }, ZERO);
  }

  mass(dim) {
    const mass = this.integral("pieces", dim - 1);
    if (mass.isZero) throw new Error(`its integral in ${dim}D is zero, so it cannot be normalised`);
    return mass;
  }

  /** σ_d with W(r, h) = σ_d h^{−d} w(r/h). */
  normalisation(dim) {
    return 1 / (SPHERE[dim] * this.mass(dim).toNumber());
  }

  /** ∫ |s|ⁿ Ŵ d^d s, exactly. */
  moment(n, dim) {
    return this.integral("pieces", n + dim - 1).over(this.mass(dim));
  }

  /** ∫ |s|ⁿ Ŵ′ d^d s, exactly. */
  slopeMoment(n, dim) {
    return this.integral("slopes", n + dim - 1).over(this.mass(dim));
  }

  /** How many derivatives vanish at the edge, less one: β, −1 where w itself does not. */
  get boundarySmoothness() {
    let piece = this.pieces[this.pieces.length - 1];
    let beta = -1;
    while (valueOf(piece, this.exactSupport).isZero) {
      piece = derivativeOf(piece);
      beta++;
    }
    return beta;
  }

  /** Parts of pieces, from the inside out: each has its outer end and Horner's coefficients there. */
  tabulate() {
    const widest = this.exactSupport.over(new Rational(BigInt(CUTS)));
    this.ends = [];
    this.centres = [];
    this.isKnot = [];
    this.tables = Array.from({ length: DERIVATIVES }, () => []);
    this.pieces.forEach((piece, i) => {
      const width = this.knots[i + 1].minus(this.knots[i]);
      const parts = Math.ceil(width.over(widest).toNumber() - 1e-12);
      for (let n = 1; n <= parts; n++) {
        const end = this.knots[i].plus(width.scaled(n).over(new Rational(BigInt(parts))));
        this.ends.push(end.toNumber());
        this.isKnot.push(n === parts);
        let local = piece;
        for (let m = 0; m < DERIVATIVES; m++) {
          this.tables[m].push(Float64Array.from(expandedAbout(local, end), (c) => c.toNumber()));
          local = derivativeOf(local);
        }
      }
    });
  }

  /** w, w′, w″ or w‴ of the shape at q ≥ 0; at a knot the mean of both sides, 0 beyond the edge. */
  shape(q, derivative = 0) {
    const { ends } = this;
    let part = 0;
    while (part < ends.length && q > ends[part] * (1 + 4 * Number.EPSILON)) part++;
    if (part === ends.length) return 0;
    const value = horner(this.tables[derivative][part], ends[part] - q);
    if (!this.isKnot[part] || Math.abs(q - ends[part]) > 4 * Number.EPSILON * q) return value;
    const next = part + 1;
    const outside = next < ends.length ? horner(this.tables[derivative][next], ends[next] - q) : 0;
    return 0.5 * (value + outside);
  }

  /** Full width at half maximum over h, null where w does not fall through half of w(0). */
  get fullWidth() {
    const level = 0.5 * this.shape(0);
    const steps = 4096;
    for (let i = 1; i <= steps; i++) {
      let [low, high] = [(i - 1) / steps, i / steps].map((x) => x * this.support);
      if (this.shape(high) > level) continue;
      for (let n = 0; n < 60; n++) {
        const middle = 0.5 * (low + high);
        if (this.shape(middle) > level) low = middle;
        else high = middle;
      }
      return Math.abs(this.shape(low) - level) < 1e-9 * level ? low + high : null;
    }
    return null;
  }
}

function horner(coefficients, t) {
  let value = 0;
  for (let i = coefficients.length - 1; i >= 0; i--) value = value * t + coefficients[i];
  return value;
}

const kernels = new Map();

/** The kernel of a name of the catalogue, or of a formula. */
function kernelOf(text) {
  const name = text.trim();
  if (!kernels.has(name)) {
    const entry = TABLES.kernels[name];
    const exact = entry
      ? {
          knots: entry.knots.map(Rational.parse),
          pieces: entry.pieces.map((p) => p.map(Rational.parse)),
        }
      : formula(name);
    if (kernels.size > 64) kernels.clear();
    kernels.set(name, new Kernel(entry ? name : "your kernel", exact.knots, exact.pieces));
  }
  return kernels.get(name);
}

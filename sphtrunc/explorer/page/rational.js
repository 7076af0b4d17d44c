// Exact rational numbers: what a kernel is made of until it becomes floats, once.

function gcd(a, b) {
  while (b) [a, b] = [b, a % b];
  return a;
}

class Rational {
  constructor(top, bottom = 1n) {
    if (bottom === 0n) throw new Error("division by zero, expected another number");
    if (bottom < 0n) [top, bottom] = [-top, -bottom];
    const common = bottom === 1n ? 1n : gcd(top < 0n ? -top : top, bottom);
    this.top = top / common;
    this.bottom = bottom / common;
  }

  /** "3", "-10/13" or "0.7", exactly. */
  static parse(text) {
    const fraction = /^\s*([+-]?\d+)\/(\d+)\s*$/.exec(text);
    if (fraction) return new Rational(BigInt(fraction[1]), BigInt(fraction[2]));
    const decimal = /^\s*([+-]?)(?=\.?\d)(\d*)\.?(\d*)\s*$/.exec(text);
    if (!decimal)
      throw new Error(`got “${text.slice(0, 40)}”, expected a number such as 0.7 or 10/13`);
    const [, sign, whole, rest] = decimal;
    return new Rational(BigInt(sign + (whole + rest || "0")), 10n ** BigInt(rest.length));
  }

  plus(x) {
    return new Rational(this.top * x.bottom + x.top * this.bottom, this.bottom * x.bottom);
  }
  minus(x) {
    return new Rational(this.top * x.bottom - x.top * this.bottom, this.bottom * x.bottom);
  }
  times(x) {
    return new Rational(this.top * x.top, this.bottom * x.bottom);
  }
  over(x) {
    return new Rational(this.top * x.bottom, this.bottom * x.top);
  }
  /** n times this, n a whole number. */
  scaled(n) {
    return new Rational(this.top * BigInt(n), this.bottom);
  }

  get isZero() {
    return this.top === 0n;
  }
  /** What elimination takes its pivots by. */
  get size() {
    return this.isZero ? 0 : 1;
  }
  get bits() {
    return Math.max(bits(this.top), bits(this.bottom));
  }
  compare(x) {
    const gap = this.top * x.bottom - x.top * this.bottom;
    return gap < 0n ? -1 : Number(gap > 0n);
  }
  toString() {
    return this.bottom === 1n ? `${this.top}` : `${this.top}/${this.bottom}`;
  }

  /** The nearest float but for one unit in the last place. */
  toNumber() {
    const shift = 64 + bits(this.bottom) - bits(this.top);
    const whole =
      shift >= 0
        ? (this.top << BigInt(shift)) / this.bottom
        : this.top / (this.bottom << BigInt(-shift));
    return Number(whole) * 2 ** -(shift >> 1) * 2 ** -(shift - (shift >> 1));
  }
}

/** How many bits a whole number has, to four. */
function bits(n) {
  return 4 * (n < 0n ? -n : n).toString(16).length;
}

const ZERO = new Rational(0n);
const ONE = new Rational(1n);

// Polynomials: coefficients, lowest degree first; [] is the zero polynomial.

function trimmed(p) {
  while (p.length && p[p.length - 1].isZero) p = p.slice(0, -1);
  return p;
}

function sumOf(p, q, sign = 1) {
  const at = (x, i) => x[i] || ZERO;
  const size = Math.max(p.length, q.length);
  return trimmed(Array.from({ length: size }, (_, i) => at(p, i).plus(at(q, i).scaled(sign))));
}

function productOf(p, q) {
  if (!p.length || !q.length) return [];
  const result = Array(p.length + q.length - 1).fill(ZERO);
  p.forEach((a, i) =>
    q.forEach((b, j) => {
      result[i + j] = result[i + j].plus(a.times(b));
    }),
  );
  return trimmed(result);
}

function valueOf(p, x) {
  return p.reduceRight((value, c) => value.times(x).plus(c), ZERO);
}

function derivativeOf(p) {
  return p.slice(1).map((c, i) => c.scaled(i + 1));
}

/** Coefficients in t = end − q. */
function expandedAbout(p, end) {
  const local = p.slice();
  for (let i = 0; i < local.length; i++) {
    for (let j = local.length - 2; j >= i; j--) local[j] = local[j].plus(local[j + 1].times(end));
  }
  return local.map((c, i) => (i % 2 ? c.scaled(-1) : c));
}

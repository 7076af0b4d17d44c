// Numbers that remember what they were made of, so that the derivative of a result with respect to
// everything it was made of is found in one walk back (reverse differentiation).

class Trace {
  constructor() {
    this.nodes = [];
  }

  number(value) {
    return new Traced(this, value, null, 0, null, 0);
  }

  /** What Σ weight · number changes by per change of every number, by its index. */
  back(seeds) {
    const change = new Float64Array(this.nodes.length);
    for (const [node, weight] of seeds) change[node.index] += weight;
    for (let i = this.nodes.length - 1; i >= 0; i--) {
      const { left, leftSlope, right, rightSlope } = this.nodes[i];
      if (!change[i]) continue;
      if (left) change[left.index] += leftSlope * change[i];
      if (right) change[right.index] += rightSlope * change[i];
    }
    return change;
  }
}

class Traced {
  constructor(trace, value, left, leftSlope, right, rightSlope) {
    Object.assign(this, { trace, value, left, leftSlope, right, rightSlope });
    this.index = trace.nodes.push(this) - 1;
  }

  made(value, slope, other, otherSlope) {
    return new Traced(this.trace, value, this, slope, other, otherSlope);
  }

  plus(x) {
    return this.made(this.value + x.value, 1, x, 1);
  }
  minus(x) {
    return this.made(this.value - x.value, 1, x, -1);
  }
  times(x) {
    return this.made(this.value * x.value, x.value, x, this.value);
  }
  over(x) {
    const ratio = this.value / x.value;
    return this.made(ratio, 1 / x.value, x, -ratio / x.value);
  }
  scaled(n) {
    return this.made(n * this.value, n, null, 0);
  }
  get size() {
    return Math.abs(this.value);
  }
  /** Never known: what is 0 by a symmetry of the lattice changes when particles move. */
  get isZero() {
    return false;
  }
}

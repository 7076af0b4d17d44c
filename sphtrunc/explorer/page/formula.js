// What a user types to exact pieces: the grammar of `sphtrunc --kernel`, with its caps. Nothing is
// ever evaluated as code.
//
//   pieces   0..1: 1 - 3/2*q^2 + 3/4*q^3; 1..2: (2-q)^3/4
//   powers   pos(2-q)^3 - 4*pos(1-q)^3

const CAPS = TABLES.caps;

function tokens(text) {
  if (text.length > CAPS.length) {
    throw new Error(`${text.length} characters, expected at most ${CAPS.length}`);
  }
  const pattern = /\s*(?:(\d*\.\d+|\d+)|(\.\.|\*\*|pos|[-+*\/^();:q]))/y;
  const found = [];
  const end = text.trimEnd().length;
  while (pattern.lastIndex < end) {
    const at = pattern.lastIndex;
    const match = pattern.exec(text);
    if (!match) {
      throw new Error(
        `unexpected character at “${text.slice(at, at + 12).trim()}”; a formula is made` +
          " of q, rationals, + - * / ^ ( ) and pos(...), as in 0..1: 1 - q^2/2; 1..2: (2-q)^2/2",
      );
    }
    found.push(match[1] ? { number: match[1] } : { sign: match[2] === "**" ? "^" : match[2] });
  }
  return found;
}

/** A reader of tokens: trees of [kind, …], one function per rule of the grammar. */
class Reader {
  constructor(text) {
    this.tokens = tokens(text);
    this.at = 0;
    this.depth = 0;
  }

  get next() {
    return this.tokens[this.at] || {};
  }

  /** Whether one of these signs is next; it is then behind. */
  takes(...signs) {
    if (!signs.includes(this.next.sign)) return null;
    return this.tokens[this.at++].sign;
  }

  needs(sign) {
    if (this.takes(sign)) return;
    const { number, sign: other } = this.next;
    const found = number || other ? `unexpected “${number || other}”` : "unfinished at the end";
    throw new Error(`${found}, expected “${sign}”`);
  }

  /** The whole text: a sum, or pieces [[low, high, body], …]. */
  start() {
    const first = this.sum();
    const pieces = [];
    if (this.next.sign === "..") {
      for (let low = first; ; low = this.sum()) {
        this.needs("..");
        const high = this.sum();
        this.needs(":");
        pieces.push([low, high, this.sum()]);
        if (!this.takes(";") || this.at === this.tokens.length) break;
      }
    }
    if (this.at < this.tokens.length) this.needs("end");
    return pieces.length ? { pieces } : { sum: first };
  }

  sum() {
    const terms = [[this.takes("+", "-") || "+", this.product()]];
    for (let sign; (sign = this.takes("+", "-"));) terms.push([sign, this.product()]);
    return ["sum", terms];
  }

  product() {
    const factors = [["*", this.signed()]];
    for (let sign; (sign = this.takes("*", "/"));) factors.push([sign, this.signed()]);
    return ["product", factors];
  }

  signed() {
    let sign = "+";
    for (let found; (found = this.takes("+", "-"));)
      if (found === "-") sign = sign === "+" ? "-" : "+";
    const power = this.power();
    return sign === "-" ? ["sum", [["-", power]]] : power;
  }

  power() {
    const base = this.atom();
    if (!this.takes("^")) return base;
    const { number } = this.next;
    if (!number || !/^\d{1,4}$/.test(number) || Number(number) > CAPS.degree) {
      throw new Error(`an exponent is a whole number up to ${CAPS.degree}`);
    }
    this.at++;
    return ["power", base, Number(number)];
  }

  atom() {
    if (this.next.number) return ["number", this.tokens[this.at++].number];
    if (this.takes("q")) return ["q"];
    const positive = this.takes("pos");
    this.needs("(");
    if (++this.depth > CAPS.nesting)
      throw new Error(`more than ${CAPS.nesting} nested parentheses`);
    const inner = this.sum();
    this.needs(")");
    this.depth--;
    return positive ? ["positive", inner] : inner;
  }
}

function capped(p) {
  if (p.length - 1 > CAPS.degree) {
    throw new Error(`degree ${p.length - 1}, expected at most ${CAPS.degree}`);
  }
  if (p.some((c) => c.bits > CAPS.bits)) throw new Error("a coefficient too large");
  return p;
}

/** The polynomial of a tree; pos(…) is resolved by its sign at the point `at`. */
function expanded(tree, at) {
  const [kind, inner, exponent] = tree;
  if (kind === "q") return [ZERO, ONE];
  if (kind === "number") {
    if (inner.length > CAPS.digits) throw new Error(`${inner.length} digits, expected fewer`);
    return trimmed([Rational.parse(inner)]);
  }
  if (kind === "sum") {
    return capped(
      inner.reduce(
        (total, [sign, term]) => sumOf(total, expanded(term, at), sign === "+" ? 1 : -1),
        [],
      ),
    );
  }
  if (kind === "power") {
    const base = expanded(inner, at);
    let result = [ONE];
    for (let i = 0; i < exponent; i++) result = capped(productOf(result, base));
    return result;
  }
  if (kind === "positive") {
    if (!at)
      throw new Error("pos(...) in a piece or another pos(...), expected a polynomial there");
    const value = expanded(inner, null);
    if (value.length !== 2)
      throw new Error("pos(...) takes an expression linear in q, such as pos(2-q)");
    return valueOf(value, at).top > 0n ? value : [];
  }
  return inner.reduce(
    (product, [sign, factor]) => {
      const value = expanded(factor, at);
      if (sign === "*") return capped(productOf(product, value));
      if (value.length > 1) throw new Error("division by an expression in q, expected a number");
      return capped(product.map((c) => c.over(value[0] || ZERO)));
    },
    [ONE],
  );
}

function constant(tree) {
  const value = expanded(tree, null);
  if (value.length > 1) throw new Error("a knot contains q, expected a rational number");
  return value[0] || ZERO;
}

/** Where the pos(…) of a formula change sign, beyond 0. */
function truncations(tree) {
  if (tree[0] === "positive") {
    const [b = ZERO, a = ZERO] = expanded(tree[1], null);
    if (a.isZero) throw new Error("pos(...) takes an expression linear in q, such as pos(2-q)");
    const root = b.over(a).scaled(-1);
    return root.top > 0n ? [root] : [];
  }
  if (tree[0] === "power") return truncations(tree[1]);
  return Array.isArray(tree[1]) ? tree[1].flatMap(([, child]) => truncations(child)) : [];
}

/** { knots, pieces } of a formula; throws an Error that says what is wrong with it. */
function formula(text) {
  const found = new Reader(text).start();
  if (found.pieces) {
    counted(found.pieces.length);
    const knots = [constant(found.pieces[0][0])];
    const pieces = found.pieces.map(([low, high, body]) => {
      const last = knots[knots.length - 1];
      if (constant(low).compare(last)) {
        throw new Error(
          `a piece ends at ${last} and the next starts at ${constant(low)}; expected` +
            " pieces that follow each other",
        );
      }
      knots.push(constant(high));
      return expanded(body, null);
    });
    return { knots, pieces };
  }
  const ends = [ZERO, ...truncations(found.sum)]
    .sort((a, b) => a.compare(b))
    .filter((x, i, all) => !i || x.compare(all[i - 1]));
  counted(ends.length - 1);
  if (ends.length < 2) {
    throw new Error(
      "a formula must say where it ends: write 0..2: (2-q)^3 or truncated powers such" +
        " as pos(2-q)^3",
    );
  }
  const last = ends[ends.length - 1];
  if (expanded(found.sum, last.plus(ONE)).length) {
    throw new Error(
      `the formula does not vanish beyond its last knot ${last}; expected truncated` +
        " powers such as pos(2-q)",
    );
  }
  const middle = (i) => ends[i].plus(ends[i + 1]).over(new Rational(2n));
  return { knots: ends, pieces: ends.slice(1).map((_, i) => expanded(found.sum, middle(i))) };
}

function counted(pieces) {
  if (pieces > CAPS.pieces) throw new Error(`${pieces} pieces, expected at most ${CAPS.pieces}`);
}

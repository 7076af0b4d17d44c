// A setting: what the controls say, as the text of a link and as numbers.

const KEYS = [
  "kernel",
  "dim",
  "lattice",
  "form",
  "correction",
  "dx-over-h",
  "h-over-lambda",
  "jitter",
];

/** The setting of a link's text after #; what is not said is as in TABLES.start. */
function settingOf(hash) {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const setting = { ...TABLES.start };
  for (const key of KEYS) if (given.has(key)) setting[key] = given.get(key).trim();
  const dim = given.has("dim") ? setting.dim : null;
  const lattice = TABLES.lattices[setting.lattice];
  if (!given.has("lattice") && dim) setting.lattice = TABLES.default_lattice[dim] || "";
  else if (!given.has("dim") && lattice) setting.dim = String(lattice.dim);
  return setting;
}

function hashOf(setting) {
  const text = new URLSearchParams(KEYS.map((key) => [key, setting[key]])).toString();
  return `#${text.replace(/%2F/g, "/").replace(/%3A/g, ":")}`;
}

function numberIn(setting, key, low, high) {
  let value;
  try {
    value = Rational.parse(setting[key]).toNumber();
  } catch (error) {
    throw new Error(`${key}: ${error.message}`);
  }
  if (!(value >= low && value <= high)) {
    throw new Error(`${key}: got ${setting[key]}, expected ${short(low)} to ${short(high)}`);
  }
  return value;
}

/** A few digits for a person. */
function short(x, digits = 4) {
  if (x === 0 || !Number.isFinite(x)) return String(x);
  const size = Math.abs(x);
  return size >= 1e-3 && size < 1e6
    ? String(Number(x.toPrecision(digits)))
    : x.toExponential(digits - 1).replace("e+", "e");
}

/** Δx/h at which a particle has so many neighbours, V_d (κh/Δx)^d of them. */
function ratioOf(kernel, dim, count) {
  return kernel.support * (BALL[dim] / count) ** (1 / dim);
}

/** The least and the largest Δx/h that the page goes to. */
function ratioLimits(kernel, dim) {
  return [ratioOf(kernel, dim, TABLES.most_neighbours[dim]), 0.95 * kernel.support];
}

/** The kernel, the lattice and the numbers of a setting; throws an Error that says what is wrong. */
function understood(setting) {
  const dim = Number(setting.dim);
  if (![1, 2, 3].includes(dim)) throw new Error(`dim: got ${setting.dim}, expected 1, 2 or 3`);
  const lattice = TABLES.lattices[setting.lattice];
  if (!lattice || lattice.dim !== dim) {
    throw new Error(`lattice: got ${setting.lattice}, expected one of ${dim}D`);
  }
  const { form, correction } = setting;
  if (!Object.hasOwn(TABLES.forms, form)) throw new Error(`form: got ${form}`);
  if (!TABLES.forms[form].includes(correction)) {
    throw new Error(
      `correction: got ${correction} for the form ${form}, expected one of` +
        ` ${TABLES.forms[form].join(", ")}`,
    );
  }
  let kernel;
  try {
    kernel = kernelOf(setting.kernel);
    kernel.mass(dim);
  } catch (error) {
    throw new Error(`kernel: ${error.message}`);
  }
  const dxOverH = numberIn(setting, "dx-over-h", ...ratioLimits(kernel, dim));
  const hOverLambda = numberIn(setting, "h-over-lambda", ...TABLES.h_over_lambda);
  const jitter = numberIn(setting, "jitter", 0, TABLES.most_jitter);
  if (form === "paired" && jitter) {
    throw new Error(
      "form: paired needs neighbours at ±s, which displaced particles do not have;" +
        " expected jitter 0, or the form standard",
    );
  }
  return { kernel, dim, lattice, form, correction, dxOverH, hOverLambda, jitter };
}

/** Every number of a setting, for a person and for the tests. */
function numbersOf(setting) {
  const { kernel, dim, lattice, form, correction, dxOverH, hOverLambda, jitter } =
    understood(setting);
  const estimate = new Estimate(kernel, lattice, form, correction, dxOverH);
  const moments = estimate.moments(jitter > 0);
  return {
    particles: estimate.count,
    moments: moments.map(({ mean }) => mean),
    spreads: moments.map(({ spread }) => jitter * (spread || 0)),
    error: estimate.split(hOverLambda, jitter),
    conventions: conventionsOf(kernel, dim, 1 / dxOverH),
  };
}

/** h/Δx under the names that codes have for it; null where a kernel has no such number. */
function conventionsOf(kernel, dim, hOverDx) {
  const variance = kernel.moment(2, dim).toNumber() / dim;
  const twoSigma = variance > 0 ? 2 * Math.sqrt(variance) * hOverDx : null;
  const width = kernel.fullWidth;
  return {
    h: hOverDx,
    support: kernel.support * hOverDx,
    "two-sigma": twoSigma,
    fwhm: width === null ? null : width * hOverDx,
    "dx-over-h": 1 / hOverDx,
    hdx: hOverDx,
    hfact: hOverDx,
    coefh: hOverDx / Math.sqrt(dim),
    eta: twoSigma,
    neighbours: BALL[dim] * (kernel.support * hOverDx) ** dim,
  };
}

// Curves: the present setting with one thing changed.

const spaced = (low, high, n) =>
  Array.from({ length: n }, (_, i) => low * (high / low) ** (i / (n - 1)));

/** The parts of the error against h/λ. */
function alongWavelength(known, points = 49) {
  const estimate = new Estimate(
    known.kernel,
    known.lattice,
    known.form,
    known.correction,
    known.dxOverH,
  );
  return spaced(...TABLES.h_over_lambda, points).map((x) => ({
    x,
    ...estimate.split(x, known.jitter),
  }));
}

/** The parts of the error at another Δx/h and h/λ, null where a correction is singular. */
function errorAt(known, dxOverH, hOverLambda) {
  try {
    return new Estimate(known.kernel, known.lattice, known.form, known.correction, dxOverH).split(
      hOverLambda,
      known.jitter,
    );
  } catch {
    return null;
  }
}

/** The parts of the error against the number of neighbours, V_d (κh/Δx)^d, at the present h/λ. */
function alongNeighbours(known, points = 41) {
  const { kernel, dim } = known;
  const [low, high] = ratioLimits(kernel, dim);
  return spaced(high, low, points)
    .map((ratio) => ({
      x: BALL[dim] * (kernel.support / ratio) ** dim,
      ...errorAt(known, ratio, known.hOverLambda),
    }))
    .filter(({ total }) => total !== undefined);
}

/** { p, order, neighbours } of the best path h ∝ Δx^p at fixed disorder, as exact texts. */
function pathOf(known) {
  const beta = Math.max(-1, Math.min(1, known.kernel.boundarySmoothness));
  return TABLES.paths[`${known.form} ${known.correction}`][known.dim][beta + 1];
}

/** The error against λ/Δx, from the present setting on: at its number of neighbours, and on the path
 * h ∝ Δx^p, on which there are more and more of them. */
function alongRefinement(known, points = 17, finest = 64) {
  const { kernel, dim, dxOverH, hOverLambda } = known;
  const p = Rational.parse(pathOf(known).p).toNumber();
  const start = 1 / (dxOverH * hOverLambda);
  const fixed = new Estimate(kernel, known.lattice, known.form, known.correction, dxOverH);
  const least = ratioLimits(kernel, dim)[0];
  const level = [];
  const path = [];
  for (const finer of spaced(1, finest, points)) {
    const x = start * finer;
    level.push({ x, total: fixed.split(hOverLambda / finer, known.jitter).total });
    const ratio = dxOverH * finer ** (p - 1);
    const error = ratio >= least * (1 - 1e-12) && errorAt(known, ratio, hOverLambda * finer ** -p);
    if (error) path.push({ x, total: error.total });
  }
  return { level, path };
}
